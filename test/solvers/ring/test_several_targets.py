"""Single targets, linking, filling and crossings of the Ring paper."""

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.solvers.ring.crossings import with_crossings_resolved
from track_before_detect.solvers.ring.linking import best_trajectory
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.solvers.ring.several_targets import (
    fill,
    found_one_by_one,
    several_targets,
    single_target,
)

SHAPE = (64, 64)
# Somewhere no trajectory comes near.
LOST = (60, 2)


def line(start, velocity, n_frames):
    return np.floor(np.array(start) + np.outer(np.arange(n_frames), velocity) + 0.5).astype(int)


def point_frames(seed, trajectories, snr, shape=SHAPE):
    frames = np.random.default_rng(seed).standard_normal((len(trajectories[0]), *shape))
    for positions in trajectories:
        frames[np.arange(len(positions)), positions[:, 1], positions[:, 0]] += snr
    return frames.astype(np.float32)


def link(coordinates, v_max=1):
    return best_trajectory(np.array(coordinates), v_max, SHAPE)


@pytest.mark.parametrize('method', METHODS)
def test_bright_target_is_followed_to_the_pixel(method):
    positions = line((10, 20), (0.6, -0.4), 20)
    found = single_target(point_frames(1, [positions], 12), method, 1)
    assert np.abs(found - positions).max() <= 1
    assert np.mean(np.all(found == positions, axis=1)) > 0.9


def test_found_coordinates_are_linked_with_scores_one_and_three():
    coordinates = line((5, 5), (1, 0.5), 10)
    found = link(coordinates)
    np.testing.assert_array_equal(found.positions, coordinates)
    assert found.score == 2 * 1 + 8 * 3


def test_missing_coordinates_are_predicted_with_score_two():
    coordinates = line((5, 5), (1, 0), 12)
    expected = coordinates.copy()
    coordinates[5:8] = LOST, (60, 40), (30, 60)
    found = link(coordinates)
    np.testing.assert_array_equal(found.positions, expected)
    assert found.score == 2 * 1 + 7 * 3 + 3 * 2


@pytest.mark.parametrize('away, last_score', [(4, 3), (5, 2)])
def test_window_grows_by_a_pixel_to_each_side_with_each_prediction(away, last_score):
    coordinates = line((5, 5), (1, 0), 9)
    coordinates[5:8] = LOST, (60, 40), (30, 60)
    coordinates[8, 1] += away
    assert link(coordinates).score == 2 * 1 + 3 * 3 + 3 * 2 + last_score


def test_sixth_prediction_in_a_row_ends_a_trajectory():
    coordinates = line((5, 5), (1, 0), 30)
    coordinates[10:] = np.stack([np.arange(20) % 2 * 50 + 5, np.full(20, 50)], axis=1)
    found = link(coordinates)
    assert np.isfinite(found.positions[:, 0]).sum() == 16
    assert found.score == 2 + 8 * 3 + 6 * 2


def test_prediction_outside_the_frame_ends_a_trajectory():
    coordinates = line((60, 5), (1, 0), 4).tolist() + [(5, 50), (50, 5), (5, 50)]
    np.testing.assert_array_equal(np.isfinite(link(coordinates).positions[:, 0]),
                                  [True] * 4 + [False] * 3)


def test_coordinates_too_far_apart_start_nothing():
    assert link([(5, 5), (8, 5), (12, 9), (2, 2)]) is None
    assert link([(5, 5), (8, 5), (12, 9), (2, 2)], v_max=3).score == 2 + 2 * 2


def test_turn_is_followed_by_the_last_five_frames():
    angle = np.arange(40) / 10
    coordinates = np.floor(32 + 10 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + 0.5)
    found = link(coordinates.astype(int))
    np.testing.assert_array_equal(found.positions, coordinates)


def slow_fill(frames, positions, radius):
    filled = frames.copy()
    for t, (x, y) in enumerate(positions):
        if np.isnan(x):
            continue
        x, y = int(x), int(y)
        for row in range(max(0, y - radius), min(frames.shape[1], y + radius + 1)):
            for column in range(max(0, x - radius), min(frames.shape[2], x + radius + 1)):
                if np.isfinite(frames[t, row, column]):
                    filled[t, row, column] = np.nanmedian(
                        frames[t, max(0, row - radius):row + radius + 1,
                               max(0, column - radius):column + radius + 1])
    return filled


@pytest.mark.parametrize('radius', [1, 3])
def test_fill_takes_medians_of_what_was_there_before(radius):
    frames = np.random.default_rng(5).standard_normal((5, 9, 12)).astype(np.float32)
    frames[3, 3:6, 4:6] = np.nan
    positions = np.array([(0, 0), (11, 8), (np.nan, np.nan), (5, 4), (11, 3)])
    expected = slow_fill(frames, positions, radius)
    fill(frames, positions, radius)
    np.testing.assert_allclose(frames, expected, rtol=1e-6)


def test_filled_target_is_not_found_again():
    positions = line((10, 20), (0.6, -0.4), 20)
    frames = point_frames(2, [positions], 8)
    rounds = found_one_by_one(frames, 'mff_dpr', 1, np.asarray, 1)
    (first, seen), (second, _) = next(rounds), next(rounds)
    x, y = first.positions.astype(int).T
    np.testing.assert_array_equal(seen, frames[np.arange(20), y, x])
    assert np.nanmax(np.abs(first.positions - positions)) <= 1
    assert not np.any(np.abs(second.positions - positions).max(axis=1) <= 1)


def test_rounds_end_when_one_takes_nothing_out():
    # A median of equal pixels is that pixel.
    frames = np.zeros((6, 9, 9), np.float32)
    assert len(list(found_one_by_one(frames, 'mff_dpr', 1, np.asarray, 1))) == 1


def crossing_pair():
    """Return two straight trajectories that cross in frame 15."""
    one = np.stack([np.arange(30.0), np.arange(30.0)], axis=1)
    other = np.stack([np.arange(30.0), 30 - np.arange(30.0)], axis=1)
    return one, other


def swapped(one, other, at):
    return (np.concatenate([one[:at], other[at:]]), np.concatenate([other[:at], one[at:]]))


def test_swapped_identities_are_put_right_and_others_kept():
    straight = crossing_pair()
    for given in (straight, swapped(*straight, 16)):
        for found, expected in zip(with_crossings_resolved(given), straight, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_trajectories_that_do_not_meet_are_kept():
    one, other = crossing_pair()
    given = swapped(one, other + [0, 40], 16)
    for found, expected in zip(with_crossings_resolved(given), given, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_trajectories_seen_on_one_side_of_a_meeting_are_kept():
    one, other = swapped(*crossing_pair(), 16)
    one[17:] = np.nan
    for found, expected in zip(with_crossings_resolved([one, other]), (one, other), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize('method', ['cfo_dpr', 'mff_dpr'])
def test_each_of_three_bright_targets_is_found_once(method):
    truth = [line((10, 10), (0.8, 0.6), 40), line((50, 12), (-0.5, 0.7), 40),
             line((12, 55), (0.9, -0.1), 40)]
    frames = point_frames(3, truth, 6)
    found = several_targets(frames, method, 1, 3)
    near = [[np.mean(np.abs(one.positions - positions).max(axis=1) <= 1) for positions in truth]
            for one in found]
    assert sorted(np.argmax(near, axis=1)) == [0, 1, 2]
    assert np.min(np.max(near, axis=1)) > 0.9


def test_no_targets_cannot_be_asked_for():
    with pytest.raises(ParameterError, match='n_targets must be at least 1, got 0'):
        several_targets(np.zeros((5, 8, 8)), 'mff_dp', 1, 0)
