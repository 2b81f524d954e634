"""Long work on all cores gives every result, and ends at once when it is interrupted."""

import os
import signal
import threading
import time

import pytest

from track_before_detect.parallel import (
    ahead,
    at_most_cores,
    exit_at_once_is_needed,
    map_in_threads,
    share_out,
    usable_cores,
)


def test_results_come_in_the_order_of_the_items():
    def slow_at_first(n):
        time.sleep(0.002 * (5 - n))
        return n * n

    assert map_in_threads(slow_at_first, range(5)) == [0, 1, 4, 9, 16]
    assert map_in_threads(slow_at_first, []) == []


def test_a_limit_holds_while_it_is_asked_for_and_in_its_own_thread():
    everything, seen = usable_cores(), []
    with at_most_cores(1):
        with at_most_cores(10**6):
            assert usable_cores() == everything
        assert usable_cores() == 1
        other = threading.Thread(target=lambda: seen.append(usable_cores()))
        other.start()
        other.join()
    assert usable_cores() == everything and seen == [everything]


def test_a_limit_holds_for_the_threads_that_do_the_work():
    with at_most_cores(1):
        assert map_in_threads(lambda _: usable_cores(), range(3), lambda: None) == 3 * [1]


def test_a_thread_beside_the_main_one_that_has_one_core_does_the_work_itself():
    seen = []

    def work():
        with at_most_cores(1):
            seen.extend(map_in_threads(lambda _: threading.current_thread(), range(3)))

    other = threading.Thread(target=work)
    other.start()
    other.join()
    assert seen == 3 * [other]


def begun_until_the_first_fails(do):
    """Return what is begun of work that fails, which ``do`` is told and must let through."""
    begun = []

    def fails(n):
        begun.append(n)
        time.sleep(0.01)
        raise ValueError(n)

    with pytest.raises(ValueError):
        do(fails)
    return begun


def test_an_error_reaches_the_caller_and_ends_the_work():
    begun = begun_until_the_first_fails(lambda fails: map_in_threads(fails, range(100)))
    time.sleep(0.1)
    assert len(begun) < 10


def test_an_interrupt_does_not_wait_for_what_is_running():
    released = threading.Event()
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    start = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            map_in_threads(lambda _: released.wait(20), range(10))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        assert exit_at_once_is_needed()
        released.set()
    assert time.monotonic() - start < 5
    time.sleep(0.1)
    assert not exit_at_once_is_needed()


def test_time_is_shown_while_one_waits():
    shown = []
    assert map_in_threads(lambda seconds: time.sleep(seconds), [2.5],
                          lambda: shown.append(time.monotonic())) == [None]
    assert len(shown) == 2


@pytest.mark.skipif(usable_cores() < 2, reason='needs two cores')
def test_one_item_is_made_ahead_while_another_is_worked_on():
    begun, threads = [], set()

    def items():
        for n in range(4):
            begun.append(n)
            threads.add(threading.get_ident())
            yield n

    seen = []
    for n in ahead(items()):
        seen.append(n)
        end = time.monotonic() + 5
        while len(begun) < min(n + 2, 4) and time.monotonic() < end:
            time.sleep(0.001)
        time.sleep(0.02)
        assert len(begun) == min(n + 2, 4)
    assert seen == [0, 1, 2, 3]
    assert len(threads) == 1 and threading.get_ident() not in threads


def test_an_error_of_an_item_that_is_made_ahead_comes_when_that_is_due():
    def items():
        yield 0
        raise ValueError('item 1')

    made = ahead(items())
    assert next(made) == 0
    with pytest.raises(ValueError, match='item 1'):
        next(made)


def test_nothing_more_is_made_ahead_once_that_is_closed():
    begun = []

    def items():
        for n in range(10):
            begun.append(n)
            yield n

    made = ahead(items())
    next(made)
    made.close()
    time.sleep(0.05)
    assert len(begun) <= 2 and not exit_at_once_is_needed()


def test_a_single_core_makes_nothing_ahead():
    threads = []
    with at_most_cores(1):
        for _ in ahead(threads.append(threading.get_ident()) for _ in range(3)):
            pass
    assert set(threads) == {threading.get_ident()}



def test_work_that_is_shared_out_is_done_once_whoever_does_it():
    done = []
    share_out(lambda *item: done.append(item), [(n, -n) for n in range(50)], 3)
    assert sorted(done) == [(n, -n) for n in range(50)]


def test_nothing_more_is_begun_after_an_error_of_shared_work():
    begun = begun_until_the_first_fails(
        lambda fails: share_out(fails, [(n,) for n in range(100)], 2))
    assert len(begun) < 4


def test_nobody_waits_for_helpers_that_have_not_begun():
    release = threading.Event()
    everybody = 4 * os.cpu_count()
    busy = threading.Thread(
        target=share_out, args=(lambda _: release.wait(20), [(n,) for n in range(everybody)],
                                everybody))
    busy.start()
    try:
        done = []
        share_out(lambda n: done.append(n), [(n,) for n in range(10)], 2)
        assert sorted(done) == list(range(10))
    finally:
        release.set()
        busy.join()
