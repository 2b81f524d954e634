"""The detector as a process, fed and heard over DDS."""

import pathlib
import re
import signal
import sys

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from nav_msgs.msg import Path  # noqa: E402
import numpy as np  # noqa: E402
from rcl_interfaces.msg import Parameter as ParameterMsg  # noqa: E402
from rcl_interfaces.msg import ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, SetParameters  # noqa: E402
import rclpy  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from scipy import ndimage  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Float32MultiArray, Header  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.detector_node import DetectorNode  # noqa: E402

RATE_HZ = 25.0
SHAPE = (32, 40)
# A machine that is busy elsewhere loses no frame that is sent.
DEEP = ['-p', 'qos_overrides./image.subscription.depth:=100', '-p', 'queue_length:=100']
# A threshold of its own saves the calibration.
FAST = ['-p', 'threshold:=12.0', '-p', 'batch_length:=10', '-p', 'hop:=5', '-p',
        'max_speed_px_s:=25.0', *DEEP]
SIZE = ['-p', f'frame_height:={SHAPE[0]}', '-p', f'frame_width:={SHAPE[1]}', '-p',
        f'frame_rate_hz:={RATE_HZ}']
RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
# Loops may have to be compiled, or another process that compiles waited for.
COMPILES_S = 240.0
CONFIG = pathlib.Path(__file__).parents[2] / 'config'
READY = r'ready: .*threshold'


def start(launch, station, *arguments):
    """Start a detector, listen to it and wait until it is ready; return it."""
    for kind, topic in ((PointCloud2, 'trajectories/points'), (Path, 'trajectories/path'),
                        (MarkerArray, 'trajectories/markers'),
                        (DiagnosticArray, '/diagnostics')):
        station.listen(kind, topic)
    detector = launch('detector', *FAST, *SIZE, '-p', 'reliable:=true', *arguments)
    detector.wait_for_line(READY, COMPILES_S)
    return detector


def send(station, publisher, frames, first_stamp_s=100.0, frame_id='camera'):
    """Publish frames at the rate of the recording, as fast as they are taken."""
    stamps = []
    for k, frame in enumerate(frames):
        header = Header(stamp=conversions.time_from_seconds(first_stamp_s + k / RATE_HZ),
                        frame_id=frame_id)
        stamps.append(header.stamp)
        publisher.publish(conversions.image_from_frame(frame, header))
        station.spin_for(0.01)
    return stamps


def points_of(station):
    """Return all points received, later messages last."""
    clouds = [conversions.points_to_array(message)
              for message in station.received['trajectories/points']]
    return np.concatenate(clouds) if clouds else np.zeros(0, conversions.POINT_DTYPE)


def test_it_follows_a_target_with_stamp_and_frame_id_of_the_input(launch, station, moving_target):
    start(launch, station)
    overlays = station.listen(Image, 'overlay')
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, positions = moving_target(30)
    stamps = send(station, publisher, frames)
    found = station.wait_for_diagnostics(batches=5, frames_used=30)
    assert found['frames_dropped'] == found['frames_refused'] == found['failures'] == '0'
    clouds = station.received['trajectories/points']
    station.wait_until(lambda: len(clouds) == 5, 'five clouds')
    assert [cloud.header.stamp for cloud in clouds] == stamps[9::5]
    assert {cloud.header.frame_id for cloud in clouds} == {'camera'}
    points = points_of(station)
    frame = np.rint((points['t'] - 100.0) * RATE_HZ).astype(int)
    assert set(frame) == set(range(30))
    error = np.hypot(points['x'] - positions[frame, 0], points['y'] - positions[frame, 1])
    assert error.mean() < 1.0
    assert set(points['id']) == {points['id'][0]}
    paths = station.received['trajectories/path']
    station.wait_until(lambda: len(paths) == 5, 'five paths')
    assert [pose.header.stamp for pose in paths[-1].poses] == stamps[20:]
    markers = station.received['trajectories/markers']
    station.wait_until(lambda: len(markers) == 5, 'five messages of markers')
    kept = [marker for message in markers for marker in message.markers]
    assert {(marker.ns, marker.id, marker.action) for marker in kept} == {
        (ns, points['id'][0], Marker.ADD) for ns in ('trajectory', 'label')}
    station.wait_until(lambda: overlays, 'an overlay')
    assert (overlays[-1].height, overlays[-1].width, overlays[-1].encoding) == (*SHAPE, 'rgb8')
    assert overlays[-1].header.frame_id == 'camera'


@pytest.mark.parametrize('name', ['mt_dp', 'pc_dp'])
def test_complex_images_are_searched(launch, station, moving_target, name):
    start(launch, station, '-p', f'detector:={name}', '-p', 'amplitudes:=complex')
    publisher = station.publisher(Image, 'image', RELIABLE)
    generator = np.random.default_rng(2)
    frames, positions = moving_target(10)
    # A phase of its own for each frame, and noise of the same power in both parts.
    frames = np.sqrt(0.5) * (frames + 1j * generator.standard_normal(frames.shape))
    frames = (frames * np.exp(2j * np.pi * generator.random(10))[:, None, None])
    for k, frame in enumerate(frames.astype(np.complex64)):
        publisher.publish(Image(
            header=Header(stamp=conversions.time_from_seconds(100.0 + k / RATE_HZ)),
            height=SHAPE[0], width=SHAPE[1], encoding='32FC2', step=8 * SHAPE[1],
            data=frame.tobytes()))
        station.spin_for(0.01)
    station.wait_for_diagnostics(batches=1, frames_used=10)
    clouds = station.received['trajectories/points']
    station.wait_until(lambda: clouds, 'a cloud')
    points = points_of(station)
    assert len(points) == 10 and len(set(points['id'])) == 1
    frame = np.rint((points['t'] - 100.0) * RATE_HZ).astype(int)
    error = np.hypot(points['x'] - positions[frame, 0], points['y'] - positions[frame, 1])
    assert error.mean() < 1.0


def test_it_learns_size_and_rate_from_the_first_frames(launch, station, moving_target):
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', *FAST, '-p', 'reliable:=true')
    station.wait_for_diagnostics(state='waiting for frames')
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, _ = moving_target(10)
    send(station, publisher, frames)
    detector.wait_for_line(READY, COMPILES_S)
    found = station.wait_for_diagnostics(state='ready', batches=1)
    assert found['frame_size'] == '32 x 40'


def shaking_scene(n_frames, shape=(64, 80)):
    """Return a textured picture from a shaking camera with one target, and its positions."""
    generator = np.random.default_rng(4)
    texture = ndimage.gaussian_filter(generator.standard_normal((shape[0] + 20, shape[1] + 20)), 2)
    texture *= 60.0 / texture.std()
    rows, columns = np.mgrid[:shape[0], :shape[1]].astype(float)
    shifts = generator.uniform(-2, 2, (n_frames, 2))
    positions = np.array([12.0, 20.0]) + np.outer(np.arange(n_frames), [1.1, 0.7])
    frames = []
    for (dx, dy), (x, y) in zip(shifts, positions):
        background = ndimage.map_coordinates(texture, [rows + 10 + dy, columns + 10 + dx])
        target = 120.0 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 1.5**2))
        noise = 4.0 * generator.standard_normal(shape)
        frames.append((4000 + background + target + noise).astype(np.uint16))
    return np.array(frames), positions


def test_a_shaking_scene_is_recognised_untold_and_its_target_is_the_only_track(launch, station):
    clouds = station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', '-p', 'reliable:=true', *DEEP)
    # Its loops may have to be compiled first, by which a machine is too busy to take each frame.
    detector.wait_for_line('waiting for frames', COMPILES_S)
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, positions = shaking_scene(30)
    send(station, publisher, frames)
    station.wait_for_diagnostics(frames_received=30)
    station.wait_until(lambda: len(clouds) == 3, 'three clouds')
    found = station.wait_for_diagnostics(state='ready', batches=3, preset='auto')
    assert 'registration=auto' in found['options']
    assert 'batch_length=16, hop=8' in found['options']
    assert 'the picture moves by' in found['reasons']
    for line in found['reasons'].split('; '):
        assert detector.output.count(f'preset auto: {line}') == 1
    points = points_of(station)
    frame = np.rint((points['t'] - 100.0) * RATE_HZ).astype(int)
    assert len(set(points['id'])) == 1 and len(set(frame)) >= 27
    error = np.hypot(points['x'] - positions[frame, 0], points['y'] - positions[frame, 1])
    assert np.median(error) < 1.0
    assert '1 trajectory now' in detector.output
    assert 'not the default: queue_length=100, reliable=True' in detector.output


def test_a_simulated_clock_that_nobody_publishes_is_said(launch, station):
    detector = launch('detector', '-p', 'use_sim_time:=true')
    detector.wait_for_line('use_sim_time is set, but no time came on /clock')
    assert 'not the default: none' in detector.output


@pytest.mark.parametrize('name', ['detector.param', 'eoir_moving', 'radar_range_bearing'])
def test_the_files_of_the_presets_start_the_node(launch, station, name):
    station.listen(DiagnosticArray, '/diagnostics')
    launch('detector', '--params-file', str(CONFIG / f'{name}.yaml'))
    found = station.wait_for_diagnostics(state='waiting for frames')
    assert found['preset'] == {'detector.param': 'auto'}.get(name, name)


def test_values_that_are_set_again_are_no_change_also_of_what_is_read_only(launch, station):
    detector = start(launch, station)
    assert change(station, 'frame_width', SHAPE[1]).successful
    assert change(station, 'threshold', 12.0).successful
    assert change(station, 'psf_sigma_px', 1.3).successful
    detector.wait_for_line('changed: psf_sigma_px;')
    assert 'changed: threshold' not in detector.output
    assert 'changed: frame_width' not in detector.output


def test_plain_frames_are_stamped_on_arrival(launch, station, moving_target):
    start(launch, station)
    publisher = station.publisher(Float32MultiArray, 'frame', RELIABLE)
    frames, _ = moving_target(10)
    before_s = 1e-9 * station.node.get_clock().now().nanoseconds
    for frame in frames:
        publisher.publish(conversions.multiarray_from_frame(frame))
        station.spin_for(1.0 / RATE_HZ)
    station.wait_for_diagnostics(batches=1)
    station.wait_until(lambda: station.received['trajectories/points'], 'points')
    stamp = station.received['trajectories/points'][0].header.stamp
    after_s = 1e-9 * station.node.get_clock().now().nanoseconds
    assert before_s < conversions.seconds_from_time(stamp) < after_s


def test_frames_in_no_batch_yet_are_searched_when_asked_and_when_the_stream_pauses(
        launch, station, moving_target):
    start(launch, station, '-p', 'flush_after_s:=1000.0')
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, _ = moving_target(20)
    send(station, publisher, frames[:13])
    station.wait_for_diagnostics(frames_used=13, batches=1)
    assert station.call(Trigger, 'detector/flush', Trigger.Request()).success
    station.wait_for_diagnostics(batches=2)
    change(station, 'flush_after_s', 0.2)
    send(station, publisher, frames[13:15], first_stamp_s=100.0 + 13 / RATE_HZ)
    station.wait_for_diagnostics(batches=3)
    points = points_of(station)
    assert round((points['t'].max() - 100.0) * RATE_HZ) == 14


def test_bad_messages_are_counted_and_named_and_the_node_goes_on(launch, station, moving_target):
    detector = start(launch, station)
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, _ = moving_target(10)

    def bad(**changes):
        message = conversions.image_from_frame(
            frames[0], Header(stamp=conversions.time_from_seconds(1.0)))
        for name, value in changes.items():
            setattr(message, name, value)
        publisher.publish(message)

    n_bad = 0
    for changes, sentence in (
            ({'encoding': 'nv12'}, "encoding must be one of .*'nv12'"),
            ({'data': b'\0' * 100}, 'needs 5120 bytes, got 100'),
            ({'height': 0}, 'at least one pixel'),
            ({'step': 3}, 'step .* must be at least 160 bytes, got 3'),
            ({'data': np.full(SHAPE, np.nan, '<f4').tobytes()}, 'expected finite pixels')):
        bad(**changes)
        n_bad += 1
        found = station.wait_for_diagnostics(frames_refused=n_bad)
        assert found['level'] == DiagnosticStatus.WARN
        assert re.search(sentence, found['last_warning'])
    empty = Float32MultiArray(data=[1.0, 2.0])
    station.publisher(Float32MultiArray, 'frame', RELIABLE).publish(empty)
    station.wait_for_diagnostics(frames_refused=n_bad + 1)
    send(station, publisher, frames)
    station.wait_for_diagnostics(batches=1, frames_used=10, failures=0)
    assert 'message refused: image encoding must be one of' in detector.output
    assert 'Traceback' not in detector.output


def test_warnings_of_one_kind_are_throttled(launch, station):
    detector = start(launch, station)
    publisher = station.publisher(Image, 'image', RELIABLE)
    for _ in range(50):
        publisher.publish(Image(encoding='nonsense'))
        station.spin_for(0.01)
    station.wait_for_diagnostics(frames_refused=50)
    assert detector.output.count('message refused') <= 2


def test_a_change_of_size_in_mid_stream_starts_the_window_again(launch, station, moving_target):
    start(launch, station)
    publisher = station.publisher(Image, 'image', RELIABLE)
    send(station, publisher, moving_target(10)[0])
    station.wait_for_diagnostics(batches=1)
    larger, positions = moving_target(10, shape=(48, 56))
    send(station, publisher, larger, first_stamp_s=101.0)
    found = station.wait_for_diagnostics(batches=2, frames_used=20)
    assert found['window_restarts'] == '1'
    assert found['frame_size'] == '48 x 56'
    station.wait_until(lambda: len(station.received['trajectories/points']) == 2, 'two clouds')
    points = conversions.points_to_array(station.received['trajectories/points'][1])
    assert abs(points['x'].mean() - positions[:, 0].mean()) < 1.0


def test_a_looped_bag_resets_the_node_and_repeated_stamps_are_refused(
        launch, station, moving_target):
    start(launch, station)
    publisher = station.publisher(Image, 'image', RELIABLE)
    frames, _ = moving_target(10)
    send(station, publisher, frames)
    station.wait_for_diagnostics(batches=1)
    send(station, publisher, frames[-1:], first_stamp_s=100.0 + 9 / RATE_HZ)
    station.wait_for_diagnostics(frames_refused=1, window_restarts=0)
    send(station, publisher, frames)
    found = station.wait_for_diagnostics(batches=2, window_restarts=1)
    assert found['frames_refused'] == '1'
    station.wait_until(lambda: len(station.received['trajectories/markers']) >= 3, 'markers')
    # What was shown of the first round is removed before the second is shown.
    removed = station.received['trajectories/markers'][1].markers
    assert {marker.action for marker in removed} == {Marker.DELETE}


def change(station, name, value):
    """Set one parameter; return the result."""
    if isinstance(value, str):
        wrapped = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    elif isinstance(value, int):
        wrapped = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    else:
        wrapped = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    request = SetParameters.Request(parameters=[ParameterMsg(name=name, value=wrapped)])
    return station.call(SetParameters, 'detector/set_parameters', request).results[0]


def test_parameters_are_live_or_refused_with_a_sentence(launch, station, moving_target):
    detector = start(launch, station)
    for name, value, sentence in (
            ('psf_sigma_px', -1.0, 'psf_sigma_px must be at least 0.3 px, got -1'),
            ('detector', 'magic', 'detector must be one of convex'),
            ('hop', 11, 'hop must be at most batch_length (10), got 11'),
            ('frame_width', 50, 'frame_width cannot be changed while the node runs'),
            ('psf_sigma', 1.0, "unknown parameter 'psf_sigma'; did you mean psf_sigma_px?")):
        result = change(station, name, value)
        assert not result.successful
        assert sentence in result.reason
    # A whole number will do where a number is expected.
    assert change(station, 'threshold', 15).successful
    station.wait_for_diagnostics(state='ready', threshold='15.0000')
    assert change(station, 'batch_length', 8).successful
    detector.wait_for_line(r'ready: .*batches of 8 frames every 5')
    publisher = station.publisher(Image, 'image', RELIABLE)
    send(station, publisher, moving_target(8)[0])
    station.wait_for_diagnostics(batches=1)


def test_what_the_detector_in_use_cannot_do_is_refused_and_the_search_goes_on(launch, station):
    station.listen(DiagnosticArray, '/diagnostics')
    launch('detector')
    station.wait_for_diagnostics(state='waiting for frames')
    result = change(station, 'directions', 3)
    assert not result.successful
    assert 'convex cannot honour directions=3, only automatic' in result.reason
    assert change(station, 'detector', 'pc_dp').successful
    assert change(station, 'directions', 3).successful
    station.received['/diagnostics'].clear()
    station.wait_for_diagnostics(state='waiting for frames')


def test_a_change_reads_the_file_of_an_option_once_alone_and_once_with_the_others(
        ros_domain, tmp_path):
    path = tmp_path / 'psf.npy'
    np.save(path, np.outer([1, 2, 1], [1, 2, 1]))
    opened = []
    sys.addaudithook(lambda event, arguments: event == 'open' and opened.append(arguments[0]))
    rclpy.init()
    node = DetectorNode()
    try:
        assert node.set_parameters([Parameter('psf', value=str(path))])[0].successful
        assert [str(name) for name in opened].count(str(path)) == 2
    finally:
        node.destroy_node()
        rclpy.shutdown()


def test_parameters_describe_themselves(launch, station):
    start(launch, station)
    response = station.call(
        DescribeParameters, 'detector/describe_parameters',
        DescribeParameters.Request(names=['psf_sigma_px', 'detector', 'reliable']))
    psf, method, reliable = response.descriptors
    assert psf.description.endswith('[px]')
    assert psf.floating_point_range[0].from_value == pytest.approx(0.3)
    assert 'convex' in method.additional_constraints
    assert reliable.read_only and not psf.read_only


@pytest.mark.parametrize(('argument', 'sentence'), [
    ('psf_sigma_px:=-1', 'psf_sigma_px must be at least 0.3 px, got -1'),
    ('psf_sigma_px:=wide', "psf_sigma_px must be a number, got 'wide'"),
    ('psf_sigm_px:=1.0', "unknown parameter 'psf_sigm_px'; did you mean psf_sigma_px?"),
    ('hop:=30', 'hop must be at most batch_length (20), got 30'),
    ('camera_info:=camera info', "camera_info must be the name of a topic, got 'camera info'"),
    ('qos_overrides./image.subscription.reliability:=maybe', 'QoS'),
])
def test_a_bad_parameter_at_start_is_one_sentence_and_exit_code_2(launch, argument, sentence):
    detector = launch('detector', '-p', argument)
    assert detector.wait() == 2
    assert detector.output.count('\n') == 1
    assert detector.output.startswith('detector: error: ')
    assert sentence in detector.output


def test_a_parameter_file_that_is_missing_is_exit_code_2(launch, tmp_path):
    detector = launch('detector', '--params-file', str(tmp_path / 'none.yaml'))
    assert detector.wait() == 2
    assert 'Traceback' not in detector.output
    assert 'none.yaml' in detector.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(launch, station, number, moving_target):
    detector = start(launch, station)
    publisher = station.publisher(Image, 'image', RELIABLE)
    send(station, publisher, moving_target(12)[0])
    assert detector.interrupt(number) == 0
    assert 'Traceback' not in detector.output
    assert 'rror' not in detector.output


def test_a_publisher_that_cannot_be_heard_is_named_loudly(launch, station):
    detector = start(launch, station)
    station.node.create_publisher(
        Image, 'image', QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT))
    detector.wait_for_line("a publisher on 'image' offers a quality of service .*RELIABILITY")
    station.wait_for_diagnostics(incompatible_publishers=1)


def test_quality_of_service_can_be_overridden_the_standard_way(launch, station, moving_target):
    detector = start(
        launch, station, '-p', 'qos_overrides./image.subscription.reliability:=best_effort')
    publisher = station.publisher(
        Image, 'image', QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT))
    station.wait_until(lambda: send(station, publisher, moving_target(1)[0])
                       and station.diagnostics().get('frames_received', '0') != '0', 'a frame')
    assert 'offers a quality of service' not in detector.output


def test_diagnostics_go_on_while_a_simulated_clock_stands_still(launch, station):
    start(launch, station, '-p', 'use_sim_time:=true')
    messages = station.received['/diagnostics']
    messages.clear()
    station.wait_until(lambda: len(messages) >= 2, 'two diagnostics')
