"""Targets as messages of vision, radar and Foxglove, in the classes of their packages."""

import math
from uuid import UUID, uuid4

import numpy as np
import pytest

pytest.importorskip('rclpy')

from std_msgs.msg import Header  # noqa: E402

from track_before_detect.errors import ParameterError  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.outputs.field_messages import (  # noqa: E402
    detections_2d,
    image_annotations,
    radar_tracks,
)
from track_before_detect.ros.outputs.field_outputs import (  # noqa: E402
    SCALE_PARAMETERS,
)
from track_before_detect.ros.outputs.seen_targets import (  # noqa: E402
    RadarScale,
    SeenTarget,
    targets_in,
)
from track_before_detect.types import Trajectory  # noqa: E402

HEADER = Header(stamp=conversions.time_from_seconds(12.5), frame_id='camera')
COVARIANCE = np.array([[0.04, 0.01], [0.01, 0.09]])
TARGET = SeenTarget(7, np.array([20.25, 31.5]), np.array([2.0, -4.0]), COVARIANCE, 3.5)
POLAR = RadarScale(2.0, 100.0, bearing_rad=-0.01, first_bearing_rad=0.5)
DOPPLER = RadarScale(2.0, 100.0, doppler_m_s=0.5)


def test_targets_of_a_frame_are_those_present_in_it():
    positions = np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]])
    one = Trajectory(3, positions, np.ones(3), positions, np.arange(3.0), np.array([4, 5, 7]),
                     9.0, 3.0, covariance=np.stack([k * np.eye(2) for k in range(3)]))
    assert not targets_in([one], 5) and not targets_in([one], 6)
    [seen] = targets_in([one], 7)
    assert (seen.id, *seen.position, seen.covariance[0, 0]) == (3, 3.0, 4.0, 2.0)


def test_detections_have_the_id_place_and_covariance_of_their_targets(messages):
    array = detections_2d(messages['vision_msgs'], [TARGET], HEADER, 6.0)
    [detection] = array.detections
    assert array.header == detection.header == HEADER
    assert (detection.id, detection.bbox.size_x, detection.bbox.size_y) == ('7', 6.0, 6.0)
    center = detection.bbox.center.position
    pose = detection.results[0].pose
    assert (center.x, center.y) == (pose.pose.position.x, pose.pose.position.y) == (20.25, 31.5)
    np.testing.assert_array_equal(np.reshape(pose.covariance, (6, 6))[:2, :2], COVARIANCE)


def test_annotations_are_shifted_from_centres_to_corners(messages):
    shown = image_annotations(messages['foxglove_msgs'], [TARGET], HEADER, 6.0)
    [circle], [text] = shown.circles, shown.texts
    assert (circle.position.x, circle.position.y, circle.diameter) == (20.75, 32.0, 6.0)
    assert circle.timestamp == text.timestamp == HEADER.stamp
    assert text.text == '7  SNR 3.5' and circle.outline_color == text.text_color


def test_tracks_have_metres_and_an_id_that_is_the_same_in_all_frames(messages):
    stream = uuid4()
    first, again = (radar_tracks(messages['radar_msgs'], [TARGET, TARGET._replace(id=8)], HEADER,
                                 POLAR, 16, 0, stream) for _ in range(2))
    identities = [UUID(bytes=bytes(track.uuid.uuid)) for track in first.tracks]
    assert identities[0] != identities[1]
    assert bytes(again.tracks[0].uuid.uuid) == identities[0].bytes
    track, motion = first.tracks[0], POLAR.motion(TARGET, 16)
    assert first.header == HEADER
    assert [track.position.x, track.position.y, track.position.z] == motion.position.tolist()
    assert [track.velocity.x, track.velocity.y, track.velocity.z] == motion.velocity.tolist()
    np.testing.assert_allclose(
        track.position_covariance, motion.position_covariance[np.triu_indices(3)], rtol=1e-6)
    assert all(math.isnan(value) for name in ('velocity', 'acceleration', 'size')
               for value in getattr(track, f'{name}_covariance'))


def test_no_target_gives_an_empty_message(messages):
    assert not detections_2d(messages['vision_msgs'], [], HEADER, 6.0).detections
    assert not radar_tracks(messages['radar_msgs'], [], HEADER, POLAR, 16, 0, uuid4()).tracks
    assert not image_annotations(messages['foxglove_msgs'], [], HEADER, 6.0).circles


def test_unknown_covariance_is_told_as_such(messages):
    target = TARGET._replace(covariance=np.full((2, 2), np.nan))
    [detection] = detections_2d(messages['vision_msgs'], [target], HEADER, 6.0).detections
    [track] = radar_tracks(messages['radar_msgs'], [target], HEADER, POLAR, 16, 0,
                           uuid4()).tracks
    assert math.isnan(detection.results[0].pose.covariance[0])
    assert math.isnan(track.position_covariance[0])


def place(pixels):
    return POLAR.motion(TARGET._replace(position=np.asarray(pixels)), 16).position[:2]


def test_bearing_and_range_become_metres_ahead_and_to_the_left():
    motion = POLAR.motion(TARGET, 16)
    distance, bearing = 163.0, 0.5 - 0.2025
    np.testing.assert_allclose(
        motion.position, [distance * math.cos(bearing), distance * math.sin(bearing), 0.0])
    after = place(TARGET.position + 1e-6 * TARGET.velocity)
    np.testing.assert_allclose(motion.velocity[:2], (after - motion.position[:2]) / 1e-6,
                               rtol=1e-4)


def test_covariance_in_metres_is_that_of_drawn_positions():
    drawn = np.random.default_rng(3).multivariate_normal(TARGET.position, COVARIANCE, 20_000)
    np.testing.assert_allclose(
        POLAR.motion(TARGET, 16).position_covariance[:2, :2],
        np.cov(np.array([place(one) for one in drawn]).T), rtol=0.05)


def test_doppler_is_the_speed_ahead_and_across_nothing_is_known():
    motion = DOPPLER.motion(TARGET, 16)
    assert motion.position.tolist() == [163.0, 0.0, 0.0]
    assert motion.velocity.tolist() == [0.5 * 4.25, 0.0, 0.0]
    np.testing.assert_allclose(np.diag(motion.position_covariance), [0.36, 163.0**2, 0.0])
    assert motion.velocity_covariance[0, 0] == pytest.approx(0.01)
    assert np.isnan(motion.velocity_covariance[1, 1])


def test_ambiguous_doppler_is_that_of_the_change_of_range():
    # 8 m/s away from the radar, on a map that begins again every 16 m/s.
    target = TARGET._replace(velocity=np.array([0.0, 9.3]))
    assert DOPPLER.motion(target, 16, 32).velocity[0] == 0.5 * 4.25 + 16.0


NONE = {parameter.name: parameter.default for parameter in SCALE_PARAMETERS}


def test_scales_that_are_not_given_are_none():
    assert RadarScale.of(NONE) is None


@pytest.mark.parametrize('given', [
    {'range_m_per_row': 1.0}, {'bearing_rad_per_column': 0.01},
    {'range_m_per_row': 1.0, 'bearing_rad_per_column': 0.01, 'doppler_m_s_per_column': 1.0}])
def test_scales_that_do_not_go_together_are_refused(given):
    with pytest.raises(ParameterError, match='range_m_per_row and one of bearing'):
        RadarScale.of({**NONE, **given})
