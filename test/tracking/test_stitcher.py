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
