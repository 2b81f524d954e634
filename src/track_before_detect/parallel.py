"""The processor cores that this process may use, and long work shared out over them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import functools
import os
import queue
import threading
from typing import Any, Generic, TypeVar

_Item = TypeVar('_Item')
_Result = TypeVar('_Result')

_limit = threading.local()
WAITING_PERIOD_S = 1.0
# Threads that an interrupt left running.
_left: list[threading.Thread] = []


def usable_cores() -> int:
    """Return the number of cores this thread may share its work out over."""
    if hasattr(os, 'sched_getaffinity'):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    return min(cores, getattr(_limit, 'most', cores))


@contextmanager
def at_most_cores(most: int) -> Iterator[None]:
    """Let what this thread begins meanwhile use no more cores."""
    before = getattr(_limit, 'most', None)
    _limit.most = most
    try:
        yield
    finally:
        if before is None:
            del _limit.most
        else:
            _limit.most = before


def map_in_threads(work: Callable[[_Item], _Result], items: Sequence[_Item],
                   while_waiting: Callable[[], None] | None = None) -> list[_Result]:
    """Return the results for all items, a thread on each core; an error ends it at once.

    An interrupt (Ctrl-C) does so, too: a pool of threads would first wait for what is running,
    and once more when the interpreter exits. Compiled loops cannot be left otherwise. A thread
    that has a single core, and is not the one that interrupts reach, does the work itself. What
    this thread may use of the cores, no other one goes beyond.

    Parameters
    ----------
    work : callable
        Run for each item, in another thread.
    items : sequence
    while_waiting : callable, optional
        Called every second in this thread.
    """
    if (usable_cores() == 1 and while_waiting is None
            and threading.current_thread() is not threading.main_thread()):
        return [work(item) for item in items]
    waiting: queue.SimpleQueue[tuple[int, _Item]] = queue.SimpleQueue()
    for pair in enumerate(items):
        waiting.put(pair)
    done: queue.SimpleQueue[tuple[int, Any, BaseException | None]] = queue.SimpleQueue()
    ended = threading.Event()
    cores = usable_cores()

    def run() -> None:
        while not ended.is_set():
            try:
                number, item = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                with at_most_cores(cores):
                    result = work(item)
            except BaseException as error:
                done.put((number, None, error))
                return
            done.put((number, result, None))

    threads = [threading.Thread(target=run, daemon=True)
               for _ in range(min(cores, len(items)))]
    for thread in threads:
        thread.start()
    results: dict[int, _Result] = {}
    try:
        while len(results) < len(items):
            try:
                number, result, error = done.get(timeout=while_waiting and WAITING_PERIOD_S)
            except queue.Empty:
                if while_waiting is not None:
                    while_waiting()
                continue
            except BaseException:
                _left.extend(threads)
                raise
            if error is not None:
                raise error
            results[number] = result
    finally:
        ended.set()
    return [results[number] for number in range(len(items))]


@functools.cache
def _helpers() -> ThreadPoolExecutor:
    """Return threads that are begun when they are needed, and kept."""
    return ThreadPoolExecutor(os.cpu_count())


# None of them is in a process that is forked.
if hasattr(os, 'register_at_fork'):
    os.register_at_fork(after_in_child=_helpers.cache_clear)


def share_out(work: Callable[..., object], items: Iterable[Sequence[Any]],
              n_threads: int) -> None:
    """Call ``work(*item)`` for all items, in this thread and in others that help it.

    Nobody waits for a helper that has not begun: one that finds no free core costs nothing. For
    work of milliseconds; an interrupt waits for the items that are being worked on.

    Parameters
    ----------
    work : callable
    items : iterable of sequence
        More than threads, for these to end at about the same time where one is slower.
    n_threads : int
        Threads, this one included.
    """
    waiting = iter(tuple(items))

    def run() -> None:
        for item in waiting:
            work(*item)

    helpers = [_helpers().submit(run) for _ in range(n_threads - 1)]
    try:
        run()
    finally:
        # Nothing more is begun after an error.
        for _ in waiting:
            pass
        for helper in helpers:
            if not helper.cancel():
                helper.result()


def ahead(items: Iterable[_Item]) -> Generator[_Item]:
    """Yield items, each made in another thread while the one before is worked on.

    No more than one is made ahead, and none where there is a single core. An error comes when its
    item is due. That thread shares its work out over the cores but the one that works on an item.
    Close the iterator when it is left early.
    """
    cores = usable_cores()
    if cores == 1:
        yield from items
        return
    made: queue.SimpleQueue[tuple[list[_Item], BaseException | None]] = queue.SimpleQueue()
    wanted = threading.Semaphore(0)
    ended = threading.Event()

    def run() -> None:
        try:
            with at_most_cores(cores - 1):
                for item in items:
                    made.put(([item], None))
                    # Not held while the next one is made.
                    del item
                    wanted.acquire()
                    if ended.is_set():
                        return
            made.put(([], None))
        except BaseException as error:
            made.put(([], error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        while True:
            item, error = made.get()
            if error is not None:
                raise error
            if not item:
                return
            wanted.release()
            yield item.pop()
    except BaseException:
        _left.append(thread)
        raise
    finally:
        ended.set()
        wanted.release()


class OwnThread(ABC, Generic[_Item]):
    """Works in a thread of its own on what it is handed, of which no more than one waits.

    Attributes
    ----------
    next : object or None
        What waits.
    changed : Condition
        Guards it and ``closed``, and is notified of both.
    closed : bool
        Whether the thread is asked to end.
    """

    def __init__(self, name: str) -> None:
        self.changed = threading.Condition()
        self.closed = False
        self.next: _Item | None = None
        self._thread = threading.Thread(target=self.run, name=name, daemon=True)

    @abstractmethod
    def run(self) -> None:
        """Work on what is taken, until there is nothing more."""

    def hand_over(self, item: _Item) -> None:
        """Have this done next, in place of what waits; the first starts the thread."""
        with self.changed:
            if self.closed:
                return
            if self._thread.ident is None:
                self._thread.start()
            self.next = item
            self.changed.notify_all()

    def take(self) -> _Item | None:
        """Return what is next as soon as it is there, None when the thread is to end."""
        with self.changed:
            self.changed.wait_for(lambda: self.closed or self.next is not None)
            item, self.next = self.next, None
            return None if self.closed else item

    def close(self) -> None:
        """Ask the thread to end with what it is doing, and let go of whoever waits."""
        with self.changed:
            self.closed = True
            self.changed.notify_all()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of the thread; return whether it came in time."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()


def exit_at_once_is_needed() -> bool:
    """Return whether threads that an interrupt left are still running.

    Leaving Python while one of them compiles would crash it.
    """
    return any(thread.is_alive() for thread in _left)
