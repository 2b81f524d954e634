import itertools

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.evaluation.metrics.matching import match_trajectories


def line(x, y, n_frames=10):
    return np.column_stack([x + np.arange(n_frames), np.full(n_frames, float(y))])


def pairs(found, targets, limit=1.5):
    matching = match_trajectories(found, targets, limit)
    return {tuple(pair) for pair in matching.pairs.tolist()}


def test_each_trajectory_counts_for_one_target_and_a_second_one_for_none():
    targets = [line(0, 0), line(0, 1)]
    assert pairs([line(0, 0.4)], targets) == {(0, 0)}
    assert len(pairs([line(0, 0.1), line(0, 0.2), line(0, 0.3)], targets[:1])) == 1


def test_as_many_targets_as_possible_are_found():
    # The nearest pair first would leave the target at 0 without a trajectory.
    targets = [line(0, 0.0), line(0, 2.0)]
    assert pairs([line(0, 1.2), line(0, 3.0)], targets) == {(0, 0), (1, 1)}


def test_mean_distance_decides():
    found = line(0, 0)
    found[:3, 1] += 4.0
    assert pairs([found], [line(0, 0)], 1.21) == {(0, 0)}
    assert pairs([found], [line(0, 0)], 1.2) == set()


@pytest.mark.parametrize(('absent', 'expected'), [(5, {(0, 0)}), (6, set()), (10, set())])
def test_trajectory_must_be_there_for_half_of_the_target(absent, expected):
    found = line(0, 0)
    found[:absent] = np.nan
    assert pairs([found], [line(0, 0)]) == expected


def test_target_that_is_absent_for_a_while_is_found_in_what_is_left():
    target = line(0, 0)
    target[4:] = np.nan
    found = line(0, 0.5)
    found[2:] = np.nan
    matching = match_trajectories([found], [target], 1.5)
    np.testing.assert_array_equal(matching.distances, [[0.5] * 2 + [np.nan] * 8])


def test_nothing_matches_nothing():
    for found, targets in (([], []), ([line(0, 0)], []), ([], [line(0, 0)])):
        matching = match_trajectories(found, targets, 1.5)
        assert matching.pairs.shape == (0, 2) and len(matching.distances) == 0


@given(st.lists(st.floats(0, 5), max_size=4), st.lists(st.floats(0, 5), max_size=4))
def test_pairing_equals_the_best_of_all(found, targets):
    matching = match_trajectories(
        [line(0, y) for y in found], [line(0, y) for y in targets], 1.5)
    short, long = sorted((found, targets), key=len)
    best = max((sum(abs(a - b) < 1.5 for a, b in zip(short, chosen)),
                -sum(abs(a - b) for a, b in zip(short, chosen) if abs(a - b) < 1.5))
               for chosen in itertools.permutations(long, len(short)))
    assert len(matching.pairs) == best[0]
    assert -matching.distances.sum() / 10 == pytest.approx(best[1], abs=1e-9)
