"""Two detectors share a stream by regions, and the stitcher merges what they find."""

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from nav_msgs.msg import Path  # noqa: E402
import numpy as np  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from track_before_detect.errors import ParameterError  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.stitching.stitcher_node import StitcherNode  # noqa: E402
from track_before_detect.types import Trajectory  # noqa: E402

RATE_HZ, COMPILES_S = 25.0, 240.0
SHAPE, N_FRAMES, LENGTH, HOP = (40, 92), 55, 10, 5
REGIONS = {'left': '[0, 0, 56, 40]', 'right': '[36, 0, 56, 40]'}
RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
# Where targets are at first and their pixels a frame: across the seam, along it, in one region.
TARGETS = [((18.0, 10.0), (1.0, 0.1)), ((45.0, 33.0), (0.05, -0.1)), ((12.0, 24.0), (0.1, 0.1))]


def recorded():
    """Return frames (T, H, W), and where each target is (N, T, 2)."""
    frames = np.random.default_rng(1).standard_normal((N_FRAMES, *SHAPE)).astype(np.float32)
    rows, columns = np.mgrid[:SHAPE[0], :SHAPE[1]]
    places = np.array([np.add(start, np.outer(np.arange(N_FRAMES), velocity))
                       for start, velocity in TARGETS])
    for path in places:
        for frame, (x, y) in zip(frames, path, strict=True):
            picture = np.exp(-0.5 * ((columns - x)**2 + (rows - y)**2))
            frame += 10.0 * picture / np.linalg.norm(picture)
    return frames, places


def image(frame, number):
    return conversions.image_from_frame(frame, Header(
        stamp=conversions.time_from_seconds(100.0 + number / RATE_HZ), frame_id='camera'))


def check_once(points, places):
    """Compare the points of a batch with the targets in it; return the id of each."""
    ids = []
    for path in places:
        frame = np.rint((points['t'] - 100.0) * RATE_HZ).astype(int)
        error = np.hypot(points['x'] - path[frame, 0], points['y'] - path[frame, 1])
        own = points[error < 2.5]
        assert len(own) == len(set(own['t'])) == LENGTH
        [number] = set(own['id'])
        ids.append(number)
    assert len(points) == LENGTH * len(places)
    return ids


def test_a_target_that_crosses_the_seam_keeps_its_id_and_nothing_is_found_twice(launch, station):
    station.listen(DiagnosticArray, '/diagnostics')
    merged = station.listen(PointCloud2, 'trajectories/points')
    paths, markers = (station.listen(kind, f'trajectories/{name}') for kind, name in (
        (Path, 'path'), (MarkerArray, 'markers')))
    of_region = {name: station.listen(PointCloud2, f'/{name}/trajectories/points')
                 for name in REGIONS}
    launch('stitcher', '-p', 'inputs:=[left, right]', '-p', 'wait_s:=30.0')
    for name, region in REGIONS.items():
        told = {'region': region, 'preset': 'none', 'threshold': 12.0, 'batch_length': LENGTH,
                'hop': HOP, 'max_speed_px_s': 30.0, 'camera_info': '/camera_info',
                'reliable': 'true', 'queue_length': 100,
                'qos_overrides./image.subscription.depth': 100}
        launch('detector', '-r', f'__ns:=/{name}', '-r', 'image:=/image', *(
            word for key, value in told.items() for word in ('-p', f'{key}:={value}')))
    for name in REGIONS:
        station.wait_until(lambda name=name: station.diagnostics(f'{name}/detector').get(
            'state') in ('ready', 'waiting for frames'), 'readiness', COMPILES_S)
    publisher = station.publisher(Image, 'image', RELIABLE)
    infos = station.publisher(CameraInfo, 'camera_info', RELIABLE)
    station.wait_until(lambda: publisher.get_subscription_count()
                       == infos.get_subscription_count() == 2, 'both detectors')
    for name in REGIONS:
        station.wait_until(lambda name=name: station.node.count_subscribers(
            f'/{name}/trajectories/points') == 2, 'the stitcher')
    # What we have discovered the detectors may not have yet, and nothing tells of it.
    station.spin_for(2.0)
    frames, places = recorded()
    infos.publish(CameraInfo(
        header=Header(frame_id='camera'), height=SHAPE[0], width=SHAPE[1],
        k=[50.0, 0.0, 46.0, 0.0, 50.0, 20.0, 0.0, 0.0, 1.0]))
    # One that is too small for the regions.
    publisher.publish(image(frames[0, :20, :30], -1))
    for number, frame in enumerate(frames):
        publisher.publish(image(frame, number))
        station.spin_for(0.01)
    n_batches = (N_FRAMES - LENGTH) // HOP + 1
    for name, region in REGIONS.items():
        found = station.wait_for_diagnostics(f'{name}/detector', batches=n_batches)
        assert found['region'] == region.strip('[]').replace(',', '')
        assert found['frames_refused'] == '1' and found['frames_dropped'] == '0'
        assert 'must lie within the frames, found frames of 30 x 20' in found['last_warning']
        # The camera is that of the whole frames.
        points = conversions.points_to_array(of_region[name][-1])
        np.testing.assert_allclose(
            50.0 * points['ray_x'] / points['ray_z'], points['x'] - 46.0, atol=1e-3)
    station.wait_until(lambda: len(merged) == n_batches, 'what was merged')
    found = station.wait_for_diagnostics('stitcher', batches=n_batches)
    assert found['batches_incomplete'] == '0' and found['level'] == DiagnosticStatus.OK
    ids = [check_once(conversions.points_to_array(cloud), places) for cloud in merged]
    assert ids == [ids[0]] * n_batches and len(set(ids[0])) == len(TARGETS)
    stamps = [conversions.seconds_from_time(cloud.header.stamp) for cloud in merged]
    np.testing.assert_allclose(
        stamps, 100.0 + (LENGTH - 1 + HOP * np.arange(n_batches)) / RATE_HZ, atol=1e-6)
    assert {cloud.header.frame_id for cloud in merged} == {'camera'}
    # The target of the seam was found by both all the time, the crossing one by each in turn.
    n_found = sum(len(set(conversions.points_to_array(cloud)['id']))
                  for clouds in of_region.values() for cloud in clouds)
    n_twice = int(found['found_twice'])
    assert n_found - n_twice == int(found['trajectories']) == len(TARGETS) * n_batches
    assert n_twice > n_batches
    station.wait_until(lambda: len(paths) == len(TARGETS) * n_batches
                       and len(markers) == n_batches, 'paths and markers')
    assert {marker.id for message in markers for marker in message.markers} == set(ids[0])


def test_a_silent_detector_is_named_and_the_others_go_on(launch, station):
    station.listen(DiagnosticArray, '/diagnostics')
    merged = station.listen(PointCloud2, 'trajectories/points')
    markers = station.listen(MarkerArray, 'trajectories/markers')
    stitcher = launch('stitcher', '-p', 'inputs:=[left, right]', '-p', 'wait_s:=1.0')
    publishers = [station.publisher(PointCloud2, f'{name}/trajectories/points', RELIABLE)
                  for name in REGIONS]

    def sent(region, number, n_found=1):
        frames = 5 * number + np.arange(LENGTH)
        found = [Trajectory(7, np.stack([frames, frames], axis=1).astype(float), np.ones(LENGTH),
                            np.full((LENGTH, 2), RATE_HZ), 100.0 + frames / RATE_HZ, frames,
                            9.0 + region, 3.0)][:n_found]
        publishers[region].publish(conversions.points_from_trajectories(found, Header(
            stamp=conversions.time_from_seconds(100.0 + frames[-1] / RATE_HZ))))

    sent(0, 0)
    station.wait_until(lambda: len(merged) == 1, 'what the left found')
    found = station.wait_for_diagnostics('stitcher', silent='right')
    assert found['level'] == DiagnosticStatus.WARN
    assert found['message'].startswith('nothing came from right for 1 s: ')
    sent(0, 1)
    station.wait_until(lambda: len(merged) == 2, 'what the left found next')
    # Late, unreadable, and in time again.
    sent(1, 1)
    publishers[1].publish(PointCloud2())
    station.wait_for_diagnostics('stitcher', messages_refused=1, **{'right.batches_late': 1})
    sent(1, 2)
    sent(0, 2)
    found = station.wait_for_diagnostics('stitcher', silent='', batches=3, found_twice=1)
    assert found['batches_incomplete'] == '2'
    station.wait_until(lambda: len(merged) == 3, 'what both found')
    clouds = [conversions.points_to_array(cloud) for cloud in merged]
    assert {number for cloud in clouds for number in cloud['id']} == {1}
    assert set(clouds[2]['statistic']) == {10.0} and len(clouds[2]) == LENGTH

    def removed():
        return {marker.id for message in markers for marker in message.markers
                if marker.action == Marker.DELETE}

    # It may be what the right is about to tell of, until both tell of none.
    sent(0, 3, 0)
    station.wait_until(lambda: len(markers) == 4, 'what the left found without the right')
    assert not removed()
    sent(0, 4, 0)
    sent(1, 4, 0)
    station.wait_until(removed, 'the removal of the marker')
    assert removed() == {1}
    assert stitcher.interrupt() == 0
    assert 'Traceback' not in stitcher.output


@pytest.mark.parametrize(('inputs', 'sentence'), [
    (['left'], r"inputs must be the namespaces of two detectors at least, each once, got \['left"),
    (['a', 'b', 'a'], 'two detectors at least, each once'),
    (['left', 'a-b'], "inputs must be names of namespaces, got 'a-b'"),
])
def test_inputs_of_no_use_are_one_sentence(station, inputs, sentence):
    with pytest.raises(ParameterError, match=sentence):
        StitcherNode(context=station.node.context,
                     parameter_overrides=[Parameter('inputs', value=inputs)])
