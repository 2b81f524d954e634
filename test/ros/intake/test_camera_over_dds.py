"""The rays of a detector that hears of its camera, over DDS."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from track_before_detect.errors import ParameterError  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.detector_node import DetectorNode  # noqa: E402
from track_before_detect.ros.intake.camera_input import camera_of  # noqa: E402

SHAPE, RATE_HZ = (32, 40), 25.0
RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
OPTIONS = {'threshold': 12.0, 'batch_length': 10, 'hop': 10, 'max_speed_px_s': 25.0,
           'frame_height': SHAPE[0], 'frame_width': SHAPE[1], 'frame_rate_hz': RATE_HZ,
           'reliable': 'true', 'camera_info': 'camera/info', 'publish': 'head'}


def info(height=SHAPE[0], focal=50.0):
    return CameraInfo(
        header=Header(frame_id='optical'), height=height, width=SHAPE[1],
        distortion_model='plumb_bob', d=[-0.2, 0.05, 0.001, 0.0, 0.0],
        k=[focal, 0.0, 19.0, 0.0, focal, 15.0, 0.0, 0.0, 1.0])


def test_points_and_markers_have_rays_once_the_camera_is_known(launch, station, moving_target):
    clouds = station.listen(PointCloud2, 'trajectories/points')
    heads = station.listen(PointCloud2, 'trajectories/head')
    markers = station.listen(MarkerArray, 'trajectories/rays')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', *(word for name, value in OPTIONS.items()
                                    for word in ('-p', f'{name}:={value}')))
    detector.wait_for_line('ready: .*threshold')
    images = station.publisher(Image, 'image', RELIABLE)
    infos = station.publisher(CameraInfo, 'camera/info', 1)
    frames, _ = moving_target(40)
    stamps = 100.0 + np.arange(40) / RATE_HZ

    def batch(number, message):
        """Send the frames of a batch, and as cameras do with each what is said of the camera."""
        for k in range(10 * number, 10 * number + 10):
            infos.publish(message)
            station.spin_for(0.01)
            images.publish(conversions.image_from_frame(
                frames[k], Header(stamp=conversions.time_from_seconds(stamps[k]))))
            station.spin_for(0.01)
        station.wait_until(lambda: len(clouds) > number and len(markers) > number, 'a batch')
        return conversions.points_to_array(clouds[number])

    assert np.isnan(batch(0, info(focal=0.0))['ray_z']).all()
    assert not markers[0].markers
    detector.wait_for_line('camera/info cannot be used: the camera is not calibrated: .* no rays')

    points, camera = batch(1, info()), camera_of(info(), False)
    assert clouds[1].header.frame_id == markers[1].markers[0].header.frame_id == 'optical'
    places = np.column_stack([points['x'], points['y']])
    rays = camera.rays(places)
    np.testing.assert_allclose(
        np.column_stack([points[f'ray_{axis}'] for axis in 'xyz']), rays, atol=1e-6)
    np.testing.assert_allclose(
        np.column_stack([points['azimuth'], points['elevation']]), camera.angles(places),
        atol=1e-6)
    np.testing.assert_allclose(points['var_azimuth'], points['var_x'] / 50.0**2, rtol=0.2)
    [ray] = markers[1].markers
    assert (ray.type, ray.ns, ray.id) == (Marker.LINE_STRIP, 'ray', points['id'][0])
    assert [ray.points[1].x, ray.points[1].y, ray.points[1].z] == pytest.approx(
        rays[np.argmax(points['t'])], abs=1e-6)

    assert np.isnan(batch(2, info(height=30))['azimuth']).all()
    detector.wait_for_line(r'camera/info tells of frames of 30 x 40 .* found 32 x 40: no rays')
    found = [conversions.points_to_array(cloud) for cloud in heads]
    assert any(len(one) and np.isfinite(one['ray_x']).all() for one in found)
    assert 'Traceback' not in detector.output


def test_it_is_said_that_several_sensors_have_no_single_camera(station):
    told = {'sensors': ['left'], 'sensors.left.height': 24, 'sensors.left.width': 30,
            'camera_info': 'camera/info'}
    with pytest.raises(ParameterError, match="one sensor, got 'camera/info' beside 1 sensors"):
        DetectorNode('with_camera', context=station.node.context, parameter_overrides=[
            Parameter(name, value=value) for name, value in told.items()])
