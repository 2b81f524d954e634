"""The detector under faults: alive, and right again within one batch."""

import signal

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.qos import (  # noqa: E402
    qos_profile_parameters,
    QoSProfile,
    QoSReliabilityPolicy,
)
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Float32MultiArray, Header  # noqa: E402

from soak import wild  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402

RATE_HZ = 25.0
RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
ARGUMENTS = [part for setting in (
    'threshold:=12.0', 'batch_length:=10', 'hop:=5', 'max_speed_px_s:=25.0', 'queue_length:=100',
    'qos_overrides./image.subscription.depth:=100', 'reliable:=true', 'frame_height:=32',
    'frame_width:=40', 'frame_rate_hz:=25.0',
) for part in ('-p', setting)]
ACTIVE = 'active: frames are searched'


@pytest.fixture
def frames(moving_target):
    return moving_target(100)[0]


def send(station, publisher, frames, first_s, between=lambda: None):
    """Publish frames, and wait until those of the last batch were searched."""
    clouds = station.received['trajectories/points']
    n_before = len(clouds)
    for k, frame in enumerate(frames):
        between()
        publisher.publish(conversions.image_from_frame(frame, Header(
            stamp=conversions.time_from_seconds(first_s + k / RATE_HZ), frame_id='camera')))
        station.spin_for(0.01)
    last_s = first_s + (len(frames) - 1) // 5 * 5 / RATE_HZ
    station.wait_until(lambda: len(clouds) > n_before and conversions.seconds_from_time(
        clouds[-1].header.stamp) >= last_s - 1 / RATE_HZ - 1e-6, 'the last batch')
    return clouds[n_before:]


def is_found(cloud):
    """Return whether the batch of a cloud holds one target, in each of its frames."""
    points = conversions.points_to_array(cloud)
    return len(points) >= 10 and len(set(points['id'])) == 1


def test_it_is_right_again_within_a_batch_after_either_side_was_killed_and_the_clock_jumped(
        launch, station, frames):
    station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', *ARGUMENTS)
    detector.wait_for_line(ACTIVE)
    publisher = station.publisher(Image, 'image', RELIABLE)
    assert all(map(is_found, send(station, publisher, frames[:20], 100.0)))

    # The detector.
    assert detector.interrupt(signal.SIGKILL) == -signal.SIGKILL
    detector = launch('detector', *ARGUMENTS)
    detector.wait_for_line(ACTIVE)
    station.wait_until(publisher.get_subscription_count, 'a subscription')
    station.received['/diagnostics'].clear()
    station.wait_for_diagnostics(state='ready', batches=0)
    clouds = send(station, publisher, frames[20:30], 100.8)
    assert len(clouds) == 1 and is_found(clouds[0])

    # The sender, whose successor has another clock.
    station.node.destroy_publisher(publisher)
    publisher = station.publisher(Image, 'image', RELIABLE)
    clouds = send(station, publisher, frames[30:40], 50.0)
    assert is_found(clouds[-1])
    # Forth and back.
    for first_s in (5000.0, 20.0, 1000.0):
        clouds = send(station, publisher, frames[40:50], first_s)
        assert is_found(clouds[-1])
        assert conversions.seconds_from_time(clouds[-1].header.stamp) == pytest.approx(
            first_s + 9 / RATE_HZ)
    found = station.wait_for_diagnostics(frames_used=50, window_restarts=4)
    assert found['frames_dropped'] == found['frames_refused'] == found['failures'] == '0'


def test_a_hundred_changes_a_second_cost_no_frame_and_few_lines(launch, station, frames):
    station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', *ARGUMENTS, '-p', 'preset:=none')
    detector.wait_for_line(ACTIVE)
    publisher = station.publisher(Image, 'image', RELIABLE)
    # As many answers may wait as requests do in the node; ten, as usual, would be lost in a stall.
    client = station.node.create_client(SetParameters, 'detector/set_parameters',
                                        qos_profile=qos_profile_parameters)
    station.wait_until(client.service_is_ready, 'the service')
    station.meet(client, SetParameters.Request())
    answers = []

    def change():
        # Which of two alternates, and every tenth asks for a threshold to be calibrated.
        number = len(answers)
        wide = ParameterValue(type=ParameterType.PARAMETER_DOUBLE,
                              double_value=1.0 + 0.1 * (number % 2))
        rate = ParameterValue(type=ParameterType.PARAMETER_DOUBLE,
                              double_value=0.0 if number % 10 == 9 else 12.0)
        answers.append(client.call_async(SetParameters.Request(parameters=[
            Parameter(name='psf_sigma_px', value=wide), Parameter(name='threshold', value=rate)])))

    lines_before = detector.output.count('\n')
    send(station, publisher, frames, 100.0, change)
    station.wait_until(lambda: all(answer.done() for answer in answers), 'answers')
    assert all(result.successful for answer in answers for result in answer.result().results)
    found = station.wait_for_diagnostics(frames_used=100)
    assert found['frames_dropped'] == found['failures'] == found['messages_lost'] == '0'
    # At most ten of each kind in five seconds, whatever the machine takes for it.
    assert detector.output.count('\n') - lines_before < 60
    # The last ones hold in the end, and the target is found with them.
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=14.0)
    station.call(SetParameters, 'detector/set_parameters', SetParameters.Request(
        parameters=[Parameter(name='threshold', value=value)]))
    station.wait_for_diagnostics(state='ready', threshold='14.0000')
    assert is_found(send(station, publisher, frames[:20], 200.0)[-1])
    assert 'Traceback' not in detector.output


def test_messages_that_are_anything_among_good_ones_leave_it_right_within_a_batch(
        launch, station, frames):
    station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch('detector', *ARGUMENTS)
    detector.wait_for_line(ACTIVE)
    publishers = {kind: station.publisher(kind, topic, RELIABLE) for kind, topic in (
        (Image, 'image'), (Float32MultiArray, 'frame'))}
    rng = np.random.default_rng(11)
    for burst in range(2):
        for _ in range(50):
            for message in (wild(rng, (32, 40)) for _ in range(5)):
                publishers[type(message)].publish(message)
            # No more than the queue of a subscription holds.
            station.spin_for(0.01)
        clouds = send(station, publishers[Image], frames[20 * burst:20 * burst + 20],
                      1000.0 * (burst + 1))
        assert is_found(clouds[-1])
    found = station.wait_for_diagnostics(frames_waiting=0, failures=0)
    assert int(found['frames_refused']) > 300
    assert sum(int(found[f'frames_{what}']) for what in ('used', 'refused', 'dropped')) == int(
        found['frames_received'])
    assert detector.process.poll() is None and 'Traceback' not in detector.output
