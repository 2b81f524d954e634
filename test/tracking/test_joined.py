"""Parts of successive batches become one trajectory for each target."""

import tracemalloc

import numpy as np
import pytest

from track_before_detect.tracking.joined import JoinedTrajectories
from track_before_detect.types import Trajectory


def part(identity, first, amplitudes, offset=0.0, statistic=20.0):
    """Return a trajectory of one batch, in units of the noise times three."""
    amplitudes = np.asarray(amplitudes, float)
    frames = first + np.arange(len(amplitudes))
    positions = np.column_stack([0.5 * frames, np.full(len(frames), 7.0 + offset)])
    return Trajectory(identity, positions, 3 * amplitudes, np.ones_like(positions),
                      frames / 25, frames, statistic, float(amplitudes.mean()),
                      covariance=np.tile((1.0 + first) * np.eye(2), (len(frames), 1, 1)))


def joined(n_frames, *parts, length=20, hop=10):
    together = JoinedTrajectories(np.arange(n_frames) / 25, 1.0)
    for first in range(0, n_frames - length + 1, hop):
        together.add(np.arange(first, first + length),
                     [one for one in parts if one.frame_indices[0] == first])
    return together.trajectories()


def rows(trajectory):
    return np.flatnonzero(np.isfinite(trajectory.positions[:, 0]))


NOISE = np.tile([0.0, 1.1, 0.4, 1.6], 5)


def test_covariance_is_that_of_the_batch_a_position_comes_from():
    [one] = joined(40, part(1, 0, NOISE + 5), part(1, 20, NOISE + 5), hop=20)
    assert one.covariance[:, 1, 1].tolist() == [1.0] * 20 + [21.0] * 20
    assert not one.covariance[:, 0, 1].any()


@pytest.mark.parametrize('n_seen', [2, 9, 17])
def test_a_part_begins_and_ends_where_its_target_is_seen(n_seen):
    entering, leaving = NOISE.copy(), NOISE.copy()
    entering[-n_seen:] = leaving[:n_seen] = 6.0
    [one] = joined(60, part(1, 10, entering), part(1, 20, leaving))
    assert rows(one).tolist() == list(range(30 - n_seen, 20 + n_seen))
    for values in (one.velocity[:, 0], one.amplitudes, one.covariance[:, 0, 0]):
        np.testing.assert_array_equal(np.flatnonzero(np.isfinite(values)), rows(one))


def test_nothing_is_cut_off_where_no_other_batch_has_looked():
    entering = NOISE.copy()
    entering[-5:] = 6.0
    [one] = joined(20, part(1, 0, entering))
    assert len(rows(one)) == 20
    [one] = joined(40, part(1, 20, entering), hop=20)
    assert rows(one).tolist() == list(range(20, 40))


def test_a_steady_dim_target_keeps_its_frames():
    [one] = joined(60, part(1, 20, np.full(20, 1.5)))
    assert rows(one).tolist() == list(range(20, 40))


def test_what_is_with_a_better_one_in_its_frames_is_no_other_target():
    leaving = NOISE.copy()
    leaving[:3] = 5.0
    better = [part(1, first, np.full(20, 6.0)) for first in (0, 10, 20)]
    found = joined(60, *better, part(2, 30, leaving, 0.5, 12.0), part(1, 30, leaving))
    assert [one.id for one in found] == [1]
    apart = joined(60, *better, part(2, 20, np.full(20, 6.0), 2.0, 12.0))
    assert [one.id for one in apart] == [1, 2]


def test_what_is_left_out_takes_no_memory_for_frames_in_which_it_is_not():
    n_frames, n_left_out = 20_000, 200
    better = [part(1, first, np.full(20, 6.0)) for first in range(0, 8000, 20)]
    worse = [part(2 + k, 40 * k, np.full(20, 6.0), 0.5, 12.0) for k in range(n_left_out)]
    together = JoinedTrajectories(np.arange(n_frames) / 25, 1.0)
    for first in range(0, n_frames, 20):
        together.add(np.arange(first, first + 20),
                     [one for one in [*better, *worse] if one.frame_indices[0] == first])
    tracemalloc.start()
    [one] = together.trajectories()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert one.id == 1 and len(one.positions) == n_frames
    row = one.positions[0].nbytes + one.velocity[0].nbytes + one.covariance[0].nbytes
    assert peak < 6 * row * n_frames


def test_trajectories_have_rows_for_all_frames_wherever_they_are():
    found = joined(80, part(1, 20, np.full(20, 6.0)), part(2, 50, np.full(20, 5.0), 9.0, 12.0))
    for one, first in zip(found, (20, 50), strict=True):
        assert one.frame_indices.tolist() == list(range(80))
        assert [len(values) for values in (one.positions, one.amplitudes, one.velocity,
                                           one.stamps, one.covariance)] == [80] * 5
        assert rows(one).tolist() == list(range(first, first + 20))
        assert one.positions[first, 0] == 0.5 * first


def test_memory_of_trajectories_over_their_own_frames_grows_with_the_recording_alone():
    peaks = []
    for n_frames in (4000, 16_000):
        together = JoinedTrajectories(np.arange(n_frames) / 25, 1.0)
        for first in range(0, n_frames, 20):
            together.add(np.arange(first, first + 20), [part(first, first, np.full(20, 6.0))])
        tracemalloc.start()
        found = together.trajectories(over_all_frames=False)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(found) == n_frames // 20
        assert {len(one.positions) for one in found} == {20}
    assert peaks[1] < 5 * peaks[0]
