"""The detector as a managed node, managed over DDS as nav2's lifecycle manager does."""

import threading
import time

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
import rclpy  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.detector_node import DetectorNode  # noqa: E402

RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
RATE_HZ = 25.0
# A threshold of its own saves the calibration.
OPTIONS = {'threshold': 12.0, 'batch_length': 10, 'hop': 5, 'max_speed_px_s': 25.0,
           'queue_length': 100, 'reliable': True, 'frame_height': 32, 'frame_width': 40,
           'frame_rate_hz': RATE_HZ}
DEEP = {'qos_overrides./image.subscription.depth': 100}
ARGUMENTS = [part for name, value in {**OPTIONS, **DEEP}.items()
             for part in ('-p', f'{name}:={value}')]


def change_state(station, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return station.call(ChangeState, 'detector/change_state', request).success


def state_of(station):
    return station.call(GetState, 'detector/get_state', GetState.Request()).current_state.label


def send(station, publisher, frames, first=0):
    for k, frame in enumerate(frames, first):
        stamp = conversions.time_from_seconds(100.0 + k / RATE_HZ)
        publisher.publish(conversions.image_from_frame(frame, Header(stamp=stamp)))
        station.spin_for(0.005)


def test_a_manager_leads_it_through_every_state(launch, station, moving_target):
    for kind, topic in ((PointCloud2, 'trajectories/points'), (DiagnosticArray, '/diagnostics'),
                        (MarkerArray, 'trajectories/markers')):
        station.listen(kind, topic)
    clouds, markers = (station.received[f'trajectories/{what}'] for what in ('points', 'markers'))
    detector = launch('detector', *ARGUMENTS, '-p', 'autostart:=false')
    frames, _ = moving_target(40)
    assert state_of(station) == 'unconfigured'
    station.wait_for_diagnostics(state='unconfigured')
    assert 'ready' not in detector.output
    # What is not possible from a state is refused, and the node goes on.
    assert not change_state(station, Transition.TRANSITION_ACTIVATE)
    assert change_state(station, Transition.TRANSITION_CONFIGURE)
    assert state_of(station) == 'inactive' and 'ready: 32 x 40 frames' in detector.output
    assert not station.node.get_subscriptions_info_by_topic('/image')
    assert change_state(station, Transition.TRANSITION_ACTIVATE)
    assert state_of(station) == 'active'
    publisher = station.publisher(Image, 'image', RELIABLE)
    send(station, publisher, frames[:20])
    station.wait_for_diagnostics(state='ready', batches=3)
    station.wait_until(lambda: len(clouds) == 3, 'three clouds')

    assert change_state(station, Transition.TRANSITION_DEACTIVATE)
    station.wait_until(
        lambda: {marker.action for marker in markers[-1].markers} == {Marker.DELETE},
        'markers to be removed')
    send(station, publisher, frames[20:23], 20)
    found = station.wait_for_diagnostics(state='inactive', frames_received=23)
    assert (found['frames_used'], found['frames_dropped']) == ('20', '3')
    assert not station.call(Trigger, 'detector/flush', Trigger.Request()).success
    assert change_state(station, Transition.TRANSITION_ACTIVATE)
    send(station, publisher, frames[23:33], 23)
    station.wait_until(lambda: len(clouds) >= 4, 'a cloud after the pause')
    found = station.wait_for_diagnostics(state='ready', frames_received=33)
    # The pause is shorter than a batch, so the target keeps its id.
    assert len({int(identity) for cloud in clouds
                for identity in conversions.points_to_array(cloud)['id']}) == 1

    assert change_state(station, Transition.TRANSITION_DEACTIVATE)
    assert change_state(station, Transition.TRANSITION_CLEANUP)
    assert state_of(station) == 'unconfigured'
    station.wait_until(lambda: not publisher.get_subscription_count(), 'no subscription')
    assert station.wait_for_diagnostics(state='unconfigured')['frames_received'] == '0'
    assert change_state(station, Transition.TRANSITION_CONFIGURE)
    assert change_state(station, Transition.TRANSITION_ACTIVATE)
    n_clouds = len(clouds)
    station.wait_until(publisher.get_subscription_count, 'a subscription')
    send(station, publisher, frames[:10])
    station.wait_until(lambda: len(clouds) == n_clouds + 1, 'a cloud')
    assert change_state(station, Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert state_of(station) == 'finalized'
    assert not change_state(station, Transition.TRANSITION_CONFIGURE)
    assert detector.interrupt() == 0
    assert 'Traceback' not in detector.output


def test_it_shares_an_executor_with_other_nodes_of_a_process(ros_domain, moving_target):
    rclpy.init()
    executor = SingleThreadedExecutor()
    other = rclpy.create_node('other')
    detector = DetectorNode('tracker', namespace='port', parameter_overrides=[
        Parameter(name, value=value) for name, value in OPTIONS.items()])
    clouds = []
    other.create_subscription(PointCloud2, '/port/trajectories/points', clouds.append, 10)
    publisher = other.create_publisher(Image, '/port/image', RELIABLE)
    for node in (other, detector):
        executor.add_node(node)
    try:
        def spin_until(condition):
            end_s = time.monotonic() + 60.0
            while not condition() and time.monotonic() < end_s:
                executor.spin_once(timeout_sec=0.05)
            assert condition()
        spin_until(publisher.get_subscription_count)
        for k, frame in enumerate(moving_target(10)[0]):
            publisher.publish(conversions.image_from_frame(
                frame, Header(stamp=conversions.time_from_seconds(1.0 + k / RATE_HZ))))
        spin_until(lambda: clouds)
        assert detector.lifecycle_state == 'active'
    finally:
        executor.shutdown()
        for node in (detector, other):
            node.destroy_node()
        rclpy.shutdown()
    assert 'search' not in {thread.name for thread in threading.enumerate()}
