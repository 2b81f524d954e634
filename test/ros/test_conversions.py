from dataclasses import replace

import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402
from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from hypothesis.extra import numpy as hnp  # noqa: E402
import numpy as np  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Float32MultiArray, Header  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from track_before_detect.errors import DataError  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.types import Trajectory  # noqa: E402

HEADER = Header(stamp=Time(sec=1_700_000_000, nanosec=123_456_789), frame_id='camera')
SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)
FRAMES = st.sampled_from(['u1', 'u2', 'f4', 'f8']).flatmap(
    lambda dtype: hnp.arrays(np.dtype(dtype), SHAPES))


def wired(message):
    """Return the message as it comes out of the middleware."""
    return deserialize_message(serialize_message(message), type(message))


def trajectory(identity=7, n_frames=4, absent=()):
    rows = np.arange(n_frames)
    positions = np.column_stack([10.25 + rows, 20.5 - rows])
    positions[list(absent)] = np.nan
    return Trajectory(
        id=identity, positions=positions, amplitudes=3.0 + rows,
        velocity=np.tile([25.0, -25.0], (n_frames, 1)), stamps=1_700_000_000 + 0.04 * rows,
        frame_indices=100 + rows, statistic=9.0, snr=3.5)


@settings(deadline=None)
@given(FRAMES)
def test_a_frame_comes_back_from_an_image_as_it_was(frame):
    back = conversions.frame_from_image(wired(conversions.image_from_frame(frame, HEADER)))
    assert back.dtype == frame.dtype
    np.testing.assert_array_equal(back, frame)


@settings(deadline=None)
@given(FRAMES, st.booleans(), st.integers(0, 5), st.booleans())
def test_byte_order_and_row_padding_are_honoured(frame, big, padding, generic_name):
    names = {'u1': ('mono8', '8UC1'), 'u2': ('mono16', '16UC1'), 'f4': ('32FC1',) * 2,
             'f8': ('64FC1',) * 2}
    height, width = frame.shape
    stored = frame.astype(frame.dtype.newbyteorder('>' if big else '<'))
    rows = stored.view(np.uint8).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xAB)
    message = Image(
        height=height, width=width, encoding=names[frame.dtype.str[1:]][generic_name],
        is_bigendian=int(big), step=rows.shape[1])
    message.data = rows.tobytes()
    np.testing.assert_array_equal(conversions.frame_from_image(wired(message)), frame)


@settings(deadline=None)
@given(hnp.arrays(np.float32, SHAPES))
def test_a_frame_comes_back_from_a_multiarray_as_it_was(frame):
    message = wired(conversions.multiarray_from_frame(frame))
    assert isinstance(message, Float32MultiArray)
    np.testing.assert_array_equal(conversions.frame_from_multiarray(message), frame)


@settings(deadline=None)
@given(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))
def test_a_stamp_comes_back_from_seconds_within_their_resolution(sec, nanosec):
    stamp = Time(sec=sec, nanosec=nanosec)
    back = conversions.time_from_seconds(conversions.seconds_from_time(stamp))
    difference = (back.sec - sec) * 10**9 + back.nanosec - nanosec
    assert abs(difference) <= max(1, np.spacing(float(sec + 1)) * 1e9)


@settings(deadline=None)
@given(st.integers(0, 10**7), st.integers(1, 1000))
def test_stamps_of_a_recording_that_starts_at_zero_are_exact(frame, fps):
    stamp = conversions.time_from_seconds(frame / fps)
    assert abs(stamp.sec * 10**9 + stamp.nanosec - frame * 10**9 / fps) <= 0.5 + 1e-6 * frame / fps


def test_seconds_that_no_stamp_can_hold_are_refused():
    with pytest.raises(DataError, match='2\\^31'):
        conversions.time_from_seconds(1e12)


@pytest.mark.parametrize(('dtype', 'expected'), [
    (np.bool_, np.uint8), (np.int8, np.float32), (np.int16, np.float32),
    (np.float16, np.float32), (np.int32, np.float64), ('>u2', np.uint16)])
def test_other_pixel_types_are_sent_without_loss(dtype, expected):
    frame = np.array([[0, 1], [1, 0]], dtype)
    sent = conversions.sendable(frame)
    assert sent.dtype.newbyteorder('=') == expected
    np.testing.assert_array_equal(sent, frame)
    back = conversions.frame_from_image(conversions.image_from_frame(sent, HEADER))
    np.testing.assert_array_equal(back, frame)


def test_complex_frames_are_refused():
    with pytest.raises(DataError, match='complex'):
        conversions.sendable(np.zeros((2, 2), np.complex64))


def test_points_hold_one_row_per_trajectory_and_frame_it_is_present_in():
    message = wired(conversions.points_from_trajectories(
        [trajectory(7, absent=[1]), trajectory(9)], HEADER))
    assert isinstance(message, PointCloud2)
    assert [field.name for field in message.fields] == [
        'x', 'y', 'z', 't', 'id', 'vx', 'vy', 'amplitude', 'snr', 'statistic', 'var_x',
        'cov_xy', 'var_y']
    assert len(message.data) == message.row_step * message.height
    points = conversions.points_to_array(message)
    assert points['id'].tolist() == [7] * 3 + [9] * 4
    np.testing.assert_allclose(points['x'][:3], [10.25, 12.25, 13.25])
    np.testing.assert_array_equal(points['t'][3:], 1_700_000_000 + 0.04 * np.arange(4))
    np.testing.assert_array_equal(points['amplitude'][3:], [3, 4, 5, 6])
    np.testing.assert_array_equal(points['vy'], -25.0)
    np.testing.assert_array_equal(points['snr'], 3.5)
    np.testing.assert_array_equal(points['statistic'], 9.0)


def test_trajectories_come_back_from_points_without_the_frames_they_are_absent_in():
    covariance = np.arange(1.0, 17.0).reshape(4, 2, 2)
    sent = replace(trajectory(7, absent=[1]), covariance=covariance + covariance.swapaxes(1, 2))
    back, other = conversions.trajectories_from_points(wired(
        conversions.points_from_trajectories([sent, trajectory(9)], HEADER)))
    present = [0, 2, 3]
    for name in ('positions', 'amplitudes', 'velocity', 'stamps', 'covariance'):
        np.testing.assert_array_equal(getattr(back, name), getattr(sent, name)[present])
    assert (back.id, back.statistic, back.snr) == (7, 9.0, 3.5)
    assert (other.id, len(other.positions)) == (9, 4)
    assert conversions.trajectories_from_points(PointCloud2(
        fields=conversions.points_from_trajectories([], HEADER).fields, point_step=56)) == []


def test_a_cloud_of_something_else_is_no_trajectories():
    with pytest.raises(DataError, match='must have the fields x, y, t, .*; missing: x, y, t'):
        conversions.trajectories_from_points(PointCloud2())


def test_no_trajectories_give_an_empty_cloud():
    message = wired(conversions.points_from_trajectories([], HEADER))
    assert len(conversions.points_to_array(message)) == 0


def test_poses_of_a_path_carry_the_exact_stamps_of_their_frames():
    stamps = {100 + k: Time(sec=5, nanosec=k) for k in range(3)}
    [path] = conversions.paths_from_trajectories([trajectory(absent=[1])], HEADER, stamps)
    assert path.header == HEADER
    found = [(pose.header.stamp.sec, pose.header.stamp.nanosec) for pose in path.poses]
    assert found[:2] == [(5, 0), (5, 2)]
    # Of the last frame only the seconds are known.
    assert found[2][0] == 1_700_000_000
    assert found[2][1] == pytest.approx(120_000_000, abs=250)
    assert all(pose.header.frame_id == 'camera' for pose in path.poses)
    assert (path.poses[0].pose.position.x, path.poses[0].pose.position.y) == (10.25, 20.5)


def test_markers_keep_their_ids_and_remove_only_what_ended():
    message = conversions.markers_from_trajectories([trajectory(7)], HEADER, 1.5, ended=[3])
    kept = [marker for marker in message.markers if marker.action == Marker.ADD]
    gone = [marker for marker in message.markers if marker.action == Marker.DELETE]
    assert [(marker.ns, marker.id) for marker in kept] == [('trajectory', 7), ('label', 7)]
    assert [(marker.ns, marker.id) for marker in gone] == [('trajectory', 3), ('label', 3)]
    assert not any(marker.action == Marker.DELETEALL for marker in message.markers)
    assert len(kept[0].points) == 4
    assert all(marker.header == HEADER for marker in message.markers)
    assert (kept[0].lifetime.sec, kept[0].lifetime.nanosec) == (1, 500_000_000)


def test_markers_of_very_slow_frames_last_as_long_as_a_duration_can():
    message = conversions.markers_from_trajectories([trajectory()], HEADER, 1e10)
    assert message.markers[0].lifetime.sec == 2**31 - 1


def test_a_trajectory_of_one_frame_has_a_line_that_can_be_drawn():
    message = conversions.markers_from_trajectories([trajectory(n_frames=1)], HEADER, 1.0)
    assert len(message.markers[0].points) == 2
