"""Every measure of a recording with truth, on cases small enough to count by hand."""

import math

import numpy as np
import pytest

from track_before_detect.evaluation.studies.real.measures import measure_tracks
from track_before_detect.evaluation.studies.real.truth import Other, Truth

SHAPE = (40, 50)


def track(n_frames, rows):
    """Return positions (T, 2) that are NaN but in the frames named by ``rows``."""
    positions = np.full((n_frames, 2), np.nan)
    for frame, x, y in rows:
        positions[frame] = x, y
    return positions


def points(rows):
    """Return labels of points, from rows [frame, id, x, y]."""
    return np.array([[*row, 0, 0] for row in rows], float).reshape(-1, 6)


def measured(tracks, truth, n_batches=1, duration_s=60.0):
    return measure_tracks(tracks, truth, SHAPE, n_batches, duration_s)


def standing(n_frames, x=10, y=20):
    return [(frame, x, y) for frame in range(n_frames)]


def labels_standing(n_frames, identity=0, x=10, y=20):
    return points([(frame, identity, x, y) for frame in range(n_frames)])


def test_a_point_is_followed_up_to_three_pixels_away_and_no_farther():
    truth = Truth.of_labels(labels_standing(4), 4)
    found = track(4, [(0, 10, 20), (1, 13, 20), (2, 13.1, 20), (3, 12, 22.5)])
    # Distances 0, 3, 3.1 and 3.2.
    assert measured([found], truth).followed == 2 / 4


def test_a_box_is_followed_inside_its_sides_grown_by_two_pixels():
    labels = np.array([[frame, 0, 10, 20, 16, 8] for frame in range(4)], float)
    truth = Truth.of_labels(labels, 4)
    found = track(4, [(0, 20, 20), (1, 20.1, 20), (2, 10, 14), (3, 10, 13.9)])
    # The grown box reaches 8 + 2 px to the sides and 4 + 2 px up and down.
    assert measured([found], truth).followed == 2 / 4


def test_a_small_box_is_followed_up_to_three_pixels_from_its_centre():
    truth = Truth.of_labels(np.array([[0, 0, 10, 20, 1, 1]], float), 1)
    assert measured([track(1, [(0, 13, 20)])], truth).followed == 1


def test_every_target_counts_in_every_frame_in_which_it_is_labelled():
    truth = Truth.of_labels(
        np.concatenate([labels_standing(4), labels_standing(2, identity=1, x=40)]), 4)
    assert measured([track(4, standing(3))], truth).followed == 3 / 6


def test_any_trajectory_may_follow():
    truth = Truth.of_labels(labels_standing(4), 4)
    found = [track(4, standing(4)[:2]), track(4, standing(4)[2:])]
    result = measured(found, truth)
    assert result.followed == 1
    assert result.ids_per_target == 2
    assert result.n_false == 0


def test_nothing_found():
    truth = Truth.of_labels(labels_standing(4), 4)
    result = measured([], truth)
    assert (result.followed, result.ids_per_target, result.n_false) == (0, 0, 0)
    assert (result.p_d, result.f_a) == (0, 0)
    assert math.isnan(result.rmse_px)
    assert math.isnan(result.first_detection_frames)


def test_ids_are_counted_for_each_target_and_averaged():
    truth = Truth.of_labels(
        np.concatenate([labels_standing(6), labels_standing(6, identity=7, x=40)]), 6)
    found = [track(6, standing(6)[:3]), track(6, standing(6)[3:]), track(6, standing(6, x=40))]
    assert measured(found, truth).ids_per_target == 1.5


def test_a_trajectory_that_is_mostly_elsewhere_is_false_and_no_id_of_the_target():
    truth = Truth.of_labels(labels_standing(5), 5)
    # Two of five frames at the target, three of five.
    mostly_off = track(5, standing(2) + [(2, 30, 5), (3, 30, 5), (4, 30, 5)])
    mostly_on = track(5, standing(3) + [(3, 30, 5), (4, 30, 5)])
    result = measured([mostly_off, mostly_on, track(5, standing(5, x=44))], truth)
    assert result.n_false == 2
    assert result.ids_per_target == 1


def test_false_trajectories_per_batch_and_per_minute():
    truth = Truth.of_labels(labels_standing(5), 5)
    found = [track(5, standing(5, x=30)), track(5, standing(5, x=40)), track(5, standing(5))]
    result = measured(found, truth, n_batches=8, duration_s=30.0)
    assert result.false_per_batch == 2 / 8
    assert result.false_per_minute == 4


def test_no_rate_per_minute_without_known_times():
    truth = Truth.of_labels(labels_standing(5), 5)
    assert math.isnan(measured([], truth, duration_s=math.nan).false_per_minute)


def test_what_is_in_frames_without_labels_is_neither_true_nor_false():
    truth = Truth.of_labels(labels_standing(3), 8)
    unknown = track(8, [(5, 40, 10), (6, 40, 10), (7, 40, 10)])
    # Half of its labelled frames are at the target; the others say nothing.
    half = track(8, [(1, 10, 20), (2, 33, 5), (3, 33, 5), (4, 33, 5)])
    assert measured([unknown, half], truth).n_false == 0


def test_frames_known_to_be_empty_make_a_trajectory_false():
    truth = Truth.of_labels(labels_standing(3), 8, known=np.ones(8, bool))
    unknown = track(8, [(5, 40, 10), (6, 40, 10), (7, 40, 10)])
    half = track(8, [(1, 10, 20), (2, 33, 5), (3, 33, 5), (4, 33, 5)])
    assert measured([unknown, half], truth).n_false == 2


def test_what_is_listed_by_hand_is_not_false():
    other = Other('a bird', ((0, 30, 10), (4, 38, 10)), (3, 2))
    truth = Truth.of_labels(labels_standing(5), 5, others=(other,))
    bird = track(5, [(0, 30, 12), (1, 32, 10), (2, 34, 8), (3, 36, 10), (4, 38, 10)])
    # Where the bird is in its last frame; in the frames before it is elsewhere.
    waiting = track(5, standing(5, x=38, y=10))
    result = measured([bird, waiting], truth)
    assert result.n_false == 1
    assert result.followed == 0
    assert result.ids_per_target == 0


def test_something_listed_is_as_wide_and_as_high_as_said():
    other = Other('an aircraft', ((0, 30, 10), (1, 30, 10)), (6, 2))
    truth = Truth.of_labels(labels_standing(2), 2, others=(other,))
    inside, beside, above = (track(2, standing(2, x, y)) for x, y in
                             ((36, 12), (37, 10), (30, 13)))
    assert measured([inside], truth).n_false == 0
    assert measured([beside, above], truth).n_false == 2


def test_something_listed_ends_with_its_last_frame():
    other = Other('an aircraft', ((0, 30, 10), (1, 30, 10)), (3, 3))
    truth = Truth.of_labels(labels_standing(5), 5, others=(other,))
    assert measured([track(5, standing(5, x=30, y=10))], truth).n_false == 1


def test_the_first_detection_counts_from_the_first_label():
    truth = Truth.of_labels(labels_standing(8)[2:], 8)
    assert measured([track(8, standing(8)[5:])], truth).first_detection_frames == 3
    assert measured([track(8, standing(8))], truth).first_detection_frames == 0


def test_the_first_detection_is_the_mean_over_targets_that_are_found():
    truth = Truth.of_labels(np.concatenate([
        labels_standing(8), labels_standing(8, identity=1, x=30),
        labels_standing(8, identity=2, x=45)]), 8)
    found = [track(8, standing(8)[1:]), track(8, standing(8, x=30)[4:])]
    assert measured(found, truth).first_detection_frames == 2.5


def test_the_error_is_that_of_the_nearest_trajectory_where_it_follows():
    truth = Truth.of_labels(labels_standing(4), 4)
    near = track(4, [(0, 11, 20), (1, 10, 22), (2, 30, 5)])
    far = track(4, [(0, 12, 20), (1, 10, 22), (3, 10, 20)])
    # Errors 1, 2 and 0; in frame 2 nothing follows.
    assert measured([near, far], truth).rmse_px == pytest.approx(math.sqrt(5 / 3))


def test_a_hit_is_within_one_pixel_of_a_pixel_of_the_target_corners_included():
    truth = Truth.of_labels(labels_standing(4), 4)
    found = track(4, [(0, 11, 21), (1, 11.4, 18.6), (2, 12, 20), (3, 10, 21.6)])
    # Nearest pixels (11, 21), (11, 19), (12, 20) and (10, 22).
    assert measured([found], truth).p_d == 2 / 4


def test_pixels_more_than_four_away_are_false():
    truth = Truth.of_labels(labels_standing(4), 4)
    found = [track(4, [(0, 14, 24), (1, 15, 20), (2, 10, 15)]),
             track(4, [(0, 10, 20), (1, 15, 20)])]
    # (15, 20) twice in one frame is one pixel.
    assert measured(found, truth).f_a == 2 / (4 * 40 * 50)


def test_pixels_of_a_box_are_those_whose_centres_it_covers():
    labels = np.array([[0, 0, 10.5, 20, 4, 1], [1, 0, 10.5, 20, 4, 1]], float)
    truth = Truth.of_labels(labels, 2)
    # Columns 9 to 12 of row 20: column 13 is one away, column 14 two.
    assert measured([track(2, [(0, 13, 21), (1, 14, 20)])], truth).p_d == 1 / 2


def test_a_box_smaller_than_a_pixel_is_its_nearest_pixel():
    truth = Truth.of_labels(np.array([[0, 0, 10.4, 20.4, 0.2, 0.2]]), 1)
    assert measured([track(1, [(0, 9, 20)])], truth).p_d == 1
    assert measured([track(1, [(0, 12, 20)])], truth).p_d == 0


def test_given_pixels_of_a_target_take_the_place_of_its_box():
    pixels = np.array([[0, 0, 10, 20], [0, 0, 16, 20]])
    truth = Truth.of_labels(np.array([[0, 0, 13, 20, 7, 1]], float), 1, pixels=pixels)
    assert measured([track(1, [(0, 17, 20)])], truth).p_d == 1
    assert measured([track(1, [(0, 13, 20)])], truth).p_d == 0


def test_other_things_and_unknown_frames_count_no_false_pixels():
    other = Other('a bird', ((0, 30, 10), (1, 30, 10)), (3, 3))
    truth = Truth.of_labels(labels_standing(2), 4, others=(other,))
    result = measured([track(4, standing(4, x=30, y=10))], truth)
    assert result.f_a == 0
    result = measured([track(4, standing(4, x=44, y=10))], truth)
    assert result.f_a == 2 / (2 * 40 * 50)


def test_a_recording_known_to_hold_nothing():
    truth = Truth.of_labels(np.zeros((0, 6)), 4, known=np.ones(4, bool))
    result = measured([track(4, standing(4))], truth)
    assert result.n_false == 1
    assert math.isnan(result.followed)
    assert math.isnan(result.ids_per_target)
    assert math.isnan(result.p_d)
