"""What a detector says of odd inputs, changes and neighbours, as a process over DDS."""

import io
import time

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
import numpy as np  # noqa: E402
import PIL.Image  # noqa: E402
from rcl_interfaces.msg import Parameter as ParameterMsg  # noqa: E402
from rcl_interfaces.msg import ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
import rclpy  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image, PointCloud2  # noqa: E402
from std_msgs.msg import Float32MultiArray, Header  # noqa: E402

from track_before_detect.ros import conversions  # noqa: E402

SHAPE = (32, 40)
OPTIONS = ['-p', 'threshold:=12.0', '-p', 'batch_length:=10', '-p', 'hop:=10', '-p',
           'preset:=none', '-p', f'frame_height:={SHAPE[0]}', '-p', f'frame_width:={SHAPE[1]}',
           '-p', 'queue_length:=100', '-p', 'flush_after_s:=1000.0']
EPOCH_S = 1_700_000_000
RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


def start(launch, station, *arguments):
    """Start a detector and listen to it; return it once it has been heard."""
    station.listen(DiagnosticArray, '/diagnostics')
    station.listen(PointCloud2, 'trajectories/points')
    detector = launch('detector', *OPTIONS, *arguments)
    # Its loops may have to be compiled first.
    detector.wait_for_line('waiting for frames', 240.0)
    station.wait_for_diagnostics(state='waiting for frames')
    return detector


def stamped(seconds):
    return Header(stamp=conversions.time_from_seconds(seconds), frame_id='camera')


def parameter(name, value):
    if isinstance(value, float):
        typed = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    else:
        typed = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    return ParameterMsg(name=name, value=typed)


def change(station, **values):
    """Set parameters in one call, as ros2 param load does; return the results."""
    request = SetParameters.Request(
        parameters=[parameter(name, value) for name, value in values.items()])
    return station.call(SetParameters, 'detector/set_parameters', request).results


def test_odd_stamps_layouts_floods_and_neighbours_are_named_and_the_search_goes_on(
        launch, station, moving_target):
    detector = start(launch, station, '-p', 'reliable:=true', '-p',
                     'qos_overrides./image.subscription.depth:=100')
    image = station.publisher(Image, 'image', RELIABLE)
    frames, _ = moving_target(10)

    # Without a scale of one the library warns, which comes through the node.
    for k, frame in enumerate(50 * frames):
        image.publish(conversions.image_from_frame(frame, stamped(EPOCH_S + 0.04 * k)))
        # An odd stamp between good ones neither starts the window again nor stops it.
        for sec, nanosec in ((0, 0), (EPOCH_S, 4_000_000_000)):
            header = stamped(0.0)
            header.stamp.sec, header.stamp.nanosec = sec, nanosec
            image.publish(conversions.image_from_frame(frame, header))
        station.spin_for(0.03)
    found = station.wait_for_diagnostics(frames_used=10, frames_refused=20, batches=1)
    assert found['window_restarts'] == '0'
    assert 'header.stamp is 0' in detector.output
    detector.wait_for_line(r'\[WARN\] .*the pixels have a median of .*set noise=robust')

    message = conversions.image_from_frame(frames[0], stamped(EPOCH_S + 0.4))
    message.data = bytes(message.data) + b'123'
    image.publish(message)
    station.wait_for_diagnostics(frames_used=11)
    detector.wait_for_line('a message holds 3 bytes more than its size says')

    results = change(station, frame_width=SHAPE[1], psf_sigma_px=1.2, threshold=13.0,
                     batch_length=8, hop=8)
    assert [result.reason for result in results] == [''] * 5
    detector.wait_for_line('changed: psf_sigma_px, threshold, batch_length, hop;')
    n_lines = detector.output.count('\n')
    client = station.clients['detector/set_parameters']

    def flood(values):
        # A client holds no more than ten answers.
        answers = [client.call_async(SetParameters.Request(
            parameters=[parameter('threshold', float(value))])) for value in values]
        station.wait_until(lambda: all(answer.done() for answer in answers), 'answers')

    for value in range(14, 214, 5):
        flood(range(value, value + 5))
    detector.wait_for_line('changed: threshold; .* lines left out before')
    station.wait_until(lambda: 'threshold=213.0' in station.diagnostics()['options'],
                       'the last change')
    assert detector.output.count('\n') - n_lines < 60

    array = station.publisher(Float32MultiArray, 'frame', RELIABLE)
    array.publish(Float32MultiArray(data=frames[0].ravel().tolist()))
    station.wait_for_diagnostics(frames_used=12)
    detector.wait_for_line(r'2 publishers send frames on image and frame \(/test_station, '
                           r'/test_station\): all are searched as one stream')
    twin = rclpy.create_node('detector', context=station.node.context)
    try:
        detector.wait_for_line('2 nodes are called /detector')
    finally:
        twin.destroy_node()
    found = station.wait_for_diagnostics(publishers=2)
    assert found['level'] == DiagnosticStatus.WARN
    assert 'Traceback' not in detector.output


def test_pictures_and_arrays_are_found_by_a_steady_clock_while_that_of_ros_stands_still(
        launch, station, moving_target, monkeypatch):
    monkeypatch.delenv('HOME', raising=False)
    monkeypatch.delenv('ROS_LOG_DIR', raising=False)
    detector = start(
        launch, station, '-p', 'image_transport:=compressed', '-p', 'stamp_source:=steady', '-p',
        'use_sim_time:=true', '-p', 'noise:=robust', '-p', 'background:=temporal_median', '-r',
        'image:=camera/raw')
    detector.wait_for_line('log files go to ')
    publisher = station.publisher(CompressedImage, 'camera/raw/compressed', RELIABLE)
    frames, positions = moving_target(20)

    def send(frame):
        file = io.BytesIO()
        PIL.Image.fromarray(np.rint(1000 + frame * 100).astype(np.uint16)).save(file, 'PNG')
        message = CompressedImage(header=Header(frame_id='camera'), format='mono16; png')
        message.data = file.getvalue()
        publisher.publish(message)

    broken = CompressedImage(format='png')
    broken.data = b'nonsense'
    # What is sent before the node has discovered us is lost.
    station.wait_for_diagnostics(publishers=1)
    publisher.publish(broken)
    station.wait_for_diagnostics(frames_refused=1)
    detector.wait_for_line('message refused: its png cannot be read: it is no PNG')
    before_s = time.time()
    for frame in frames[:10]:
        send(frame)
        station.spin_for(0.04)
    station.wait_for_diagnostics(batches=1, frames_used=10)
    clouds = station.received['trajectories/points']
    station.wait_until(lambda: clouds, 'a cloud')
    assert clouds[0].header.frame_id == 'camera'
    stamp_s = conversions.seconds_from_time(clouds[0].header.stamp)
    assert before_s - 1 < stamp_s < time.time() + 1
    points = conversions.points_to_array(clouds[0])
    assert len(points) == 10
    assert np.hypot(*(np.stack([points['x'], points['y']], 1) - positions[:10]).T).mean() < 1.0

    arrays = station.publisher(Float32MultiArray, 'frame', BEST_EFFORT)

    def array_arrives():
        # What is sent before the node has discovered us is lost without reliability.
        arrays.publish(conversions.multiarray_from_frame(1000 + 100 * frames[11]))
        station.spin_for(0.3)
        return int(station.diagnostics()['frames_used']) > 10

    station.wait_until(array_arrives, 'a frame on frame')
    station.wait_for_diagnostics(frames_refused=1, publishers=2)
    # Through the segment that the middleware has by default frames of 1 MB hardly come.
    large = conversions.multiarray_from_frame(np.zeros((512, 640), np.float32))
    for _ in range(30):
        arrays.publish(large)
        station.spin_for(0.02)
    detector.wait_for_line(r"messages on 'frame' were lost; .*fastdds_profile\.xml")
    assert 'Traceback' not in detector.output
