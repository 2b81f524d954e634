"""One target keeps one id over batches."""

from dataclasses import replace

import numpy as np
import pytest

from track_before_detect.tracking.stitcher import Stitcher
from track_before_detect.types import Trajectory


def sighting(first, last, x=0.0, v=1.0):
    frames = np.arange(first, last)
    positions = np.stack([x + v * frames, np.full(len(frames), 5.0)], axis=1)
    return Trajectory(0, positions, np.ones(len(frames)), np.tile([v, 0.0], (len(frames), 1)),
                      frames.astype(float), frames, 9.0, 3.0)


def ids(trajectories):
    return [trajectory.id for trajectory in trajectories]


def test_overlapping_sightings_share_an_id_and_others_do_not():
    stitcher = Stitcher(1.0)
    assert ids(stitcher.link([sighting(0, 20), sighting(0, 20, x=30)])) == [1, 2]
    assert ids(stitcher.link([sighting(10, 30, x=30.5), sighting(10, 30, x=60),
                              sighting(10, 30, x=-0.4)])) == [2, 3, 1]


def test_adjoining_sightings_share_an_id():
    stitcher = Stitcher(1.0)
    assert ids(stitcher.link([sighting(0, 20, v=0.5)])) == [1]
    assert ids(stitcher.link([sighting(20, 40, v=0.5)])) == [1]


def test_target_missed_once_keeps_its_id_and_missed_for_long_does_not():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20)])
    stitcher.link([])
    assert ids(stitcher.link([sighting(20, 40)])) == [1]
    stitcher.link([])
    stitcher.link([])
    assert ids(stitcher.link([sighting(50, 70)])) == [2]


def test_reset_starts_new_ids():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20)])
    stitcher.reset()
    assert ids(stitcher.link([sighting(0, 20)])) == [2]


def test_crossing_targets_do_not_swap():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20, x=0, v=1), sighting(0, 20, x=30, v=-1)])
    assert ids(stitcher.link([sighting(10, 30, x=30, v=-1), sighting(10, 30, x=0, v=1)])) == [2, 1]


@pytest.mark.parametrize('rows', [slice(0, 0), slice(0, 20)])
def test_rows_without_a_position_are_no_match(rows):
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20)])
    other = sighting(10, 30)
    positions = other.positions.copy()
    positions[rows] = np.nan
    expected = 2 if rows.stop else 1
    assert ids(stitcher.link([replace(other, positions=positions)])) == [expected]


def candidate(*frames, **place):
    return replace(sighting(*frames, **place), reason='below the threshold', statistic=0.8)


def test_candidate_below_the_threshold_carries_a_trajectory_on_under_its_id():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20)])
    far, near = candidate(10, 30, x=25), candidate(10, 30, x=1.0)
    [carried] = stitcher.link([], weaker=[far, near])
    assert (carried.id, carried.reason) == (1, '')
    np.testing.assert_array_equal(carried.positions, near.positions)
    # From there it goes on.
    assert ids(stitcher.link([sighting(20, 40, x=0.5)])) == [1]


def test_nothing_is_carried_on_where_no_candidate_is_near():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20)])
    assert stitcher.link([], weaker=[candidate(10, 30, x=12)]) == []
    assert stitcher.link([], weaker=[]) == []


def test_a_trajectory_is_worth_more_than_a_candidate_and_the_strongest_candidate_most():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20)])
    found = stitcher.link([sighting(10, 30, x=0.5)], weaker=[candidate(10, 30)])
    assert [(one.id, one.statistic) for one in found] == [(1, 9.0)]
    stronger = replace(candidate(20, 40, x=1.5), statistic=0.9)
    [carried] = stitcher.link([], weaker=[candidate(20, 40), stronger])
    assert carried.statistic == 0.9


def test_candidates_alone_are_no_trajectories():
    assert Stitcher(1.0).link([], weaker=[candidate(0, 20)]) == []


def test_one_candidate_carries_on_one_trajectory():
    stitcher = Stitcher(1.0)
    stitcher.link([sighting(0, 20), sighting(0, 20, x=2.0)])
    assert len(stitcher.link([], weaker=[candidate(10, 30, x=1.0)])) == 1
