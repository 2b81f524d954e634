"""Batches of several regions are brought together, and none is waited for without an end."""

import numpy as np

from track_before_detect.ros.stitching.rounds import Rounds


def taken(rounds, now_s):
    """Return the contents of the rounds that are ready, by region."""
    return [{region: batch.content for region, batch in one.items()} for one in rounds.take(now_s)]


def test_batches_of_the_same_stamp_are_a_round_as_soon_as_all_are_there():
    rounds = Rounds(2, 1.0)
    rounds.put(0, 10.0, 'a', 0.0)
    rounds.put(0, 15.0, 'b', 0.1)
    assert taken(rounds, 0.2) == []
    rounds.put(1, 10.0, 'A', 0.3)
    assert taken(rounds, 0.3) == [{0: 'a', 1: 'A'}]
    rounds.put(1, 15.0, 'B', 0.4)
    assert taken(rounds, 0.4) == [{0: 'b', 1: 'B'}]


def test_regions_out_of_step_go_on_within_half_a_hop_of_each_other():
    rounds, found = Rounds(2, 1.0), []
    for k in range(20):
        rounds.put(0, 10.0 + 5 * k, 10.0 + 5 * k, k)
        rounds.put(1, 13.0 + 5 * k, 13.0 + 5 * k, k)
        found += taken(rounds, k)
    together = [one for one in found if len(one) == 2]
    assert len(together) > 15
    assert max(abs(one[0] - one[1]) for one in together) == 2.0
    given = sorted(stamp for one in found for stamp in one.values())
    assert len(given) == len(set(given)) > 36


def test_a_silent_region_is_waited_for_once_until_it_is_heard():
    rounds = Rounds(2, 1.0)
    rounds.put(0, 10.0, 'a', 0.0)
    assert taken(rounds, 0.9) == []
    assert taken(rounds, 1.0) == [{0: 'a'}]
    assert rounds.silent == {1}
    rounds.put(0, 15.0, 'b', 1.5)
    assert taken(rounds, 1.5) == [{0: 'b'}]
    # Too late for its round, but the next can wait for it.
    rounds.put(1, 15.0, 'B', 1.6)
    assert taken(rounds, 1.6) == []
    assert not rounds.silent and rounds.n_late == [0, 1]
    rounds.put(0, 20.0, 'c', 1.8)
    assert taken(rounds, 1.8) == []
    rounds.put(1, 20.0, 'C', 1.9)
    assert taken(rounds, 1.9) == [{0: 'c', 1: 'C'}]


def test_a_region_that_is_slow_costs_the_others_no_more_than_what_has_waited():
    rounds = Rounds(2, 1.0)
    rounds.put(0, 10.0, 'a', 0.0)
    rounds.put(1, 5.0, 'Z', 0.5)
    assert taken(rounds, 0.5) == [{1: 'Z'}]
    rounds.put(0, 15.0, 'b', 0.6)
    assert taken(rounds, 1.0) == [{0: 'a'}]
    rounds.put(1, 10.0, 'A', 1.1)
    assert rounds.n_late == [0, 1] and not rounds.silent
    rounds.put(1, 15.0, 'B', 1.4)
    assert taken(rounds, 1.4) == [{0: 'b', 1: 'B'}]


def test_batches_that_come_seldom_are_waited_for_each_time():
    rounds = Rounds(2, 1.0)
    for k in range(4):
        rounds.put(k % 2, 10.0 * k, 'first', 10.0 * k)
        assert taken(rounds, 10.0 * k) == []
        rounds.put(1 - k % 2, 10.0 * k, 'second', 10.0 * k + 0.9)
        assert len(taken(rounds, 10.0 * k + 0.9)) == 1


def test_nothing_waits_longer_than_told_whichever_batches_are_lost():
    rng = np.random.default_rng(8)
    rounds, arrived, waited = Rounds(3, 1.0), {}, []
    for k in range(300):
        now_s = 0.2 * k
        for region in range(3):
            if rng.random() < 0.7:
                arrived[region, k] = now_s
                assert not rounds.put(region, 5.0 * k, (region, k), now_s)
        for one in rounds.take(now_s):
            waited += [now_s - arrived.pop(content.content) for content in one.values()]
    assert len(waited) + sum(rounds.n_late) + sum(
        now_s - arrival < 1.0 for arrival in arrived.values()) >= 600
    assert max(waited) < 1.0 + 0.2 + 1e-9


def test_time_that_goes_back_begins_another_stream():
    rounds = Rounds(2, 1.0)
    for region in range(2):
        assert not rounds.put(region, 100.0, 'old', 0.0)
    assert len(taken(rounds, 0.0)) == 1
    assert not rounds.put(1, 105.0, 'old', 0.1)
    assert rounds.put(0, 1.0, 'new', 0.2)
    assert taken(rounds, 0.2) == []
    assert not rounds.put(1, 1.0, 'New', 0.3)
    assert taken(rounds, 0.3) == [{0: 'new', 1: 'New'}]
