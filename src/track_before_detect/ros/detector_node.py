"""Node ``detector``: frames in, trajectories out.

Topics (relative): in ``image`` (sensor_msgs/Image) or ``image/compressed``, and ``frame``
(std_msgs/Float32MultiArray); out ``trajectories/markers``, ``trajectories/path``,
``trajectories/points``, ``overlay`` and ``/diagnostics``. Service ``~/flush`` (std_srvs/Trigger)
has the frames that were in no batch yet searched at once.
"""

from collections.abc import Callable, Mapping, Set
from copy import copy
from functools import partial
import os
import signal
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import (
    QoSMessageLostInfo,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    qos_policy_name_from_kind,
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from std_msgs.msg import Float32MultiArray, Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from track_before_detect.errors import TbdError
from track_before_detect.recordings.overlay import render_overlay
from track_before_detect.ros import conversions
from track_before_detect.ros.diagnostics import (
    diagnostics_message,
    option_words,
    Reception,
    Warnings,
)
from track_before_detect.ros.frame_queue import StreamRequest
from track_before_detect.ros.intake.frame_reader import (
    ARRIVAL,
    COMPRESSED,
    FrameReader,
    HEADER,
    larger_segment_words,
    RAW,
    StampedFrame,
    STEADY,
)
from track_before_detect.ros.intake.neighbours import neighbour_warnings, senders
from track_before_detect.ros.logs.library_log import LibraryLog
from track_before_detect.ros.logs.throttled import ThrottledLog
from track_before_detect.ros.parameters import (
    NodeParameter,
    option_parameters,
    option_values,
    ParameterizedNode,
)
from track_before_detect.ros.running import run
from track_before_detect.ros.worker import StreamResult, StreamWorker
from track_before_detect.tracking.batcher import DEFAULT_LENGTH
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.presets import AUTO, PRESETS
from track_before_detect.types import STATUSES

INPUT_DEPTH = 20
OUTPUT_DEPTH = 50
DIAGNOSTICS_PERIOD_S = 1.0
PROGRESS_PERIOD_S = 2.0
TRACKED_PERIOD_S = 5.0
# Without a time of /clock until then somebody waits in vain.
CLOCK_TIMEOUT_S = 5.0
LIFETIME_BATCHES = 3.0
STOP_TIMEOUT_S = 3.0

RCLError, InvalidHandle = rclpy_implementation.RCLError, rclpy_implementation.InvalidHandle

PARAMETERS = [
    NodeParameter(
        'preset', AUTO, 'Where the options come from that are not given: auto looks at the first '
        'frames of a stream (diagnostics say what was chosen, and why), none takes the defaults, '
        'the others are for a kind of sensor. An option that is given a value, be it the default, '
        'keeps it.', 'text', choices=(AUTO, *PRESETS), live=True),
    *option_parameters({'batch_length': DEFAULT_LENGTH}),
    NodeParameter(
        'max_gap_s', 0.0, 'Longest pause between two frames of a batch; a longer one starts a '
        'new batch. Automatic is the duration of a batch.', 'number', unit='s', minimum=0.0,
        live=True, optional=True),
    NodeParameter(
        'flush_after_s', 0.0, 'Time without a new frame after which frames that were in no batch '
        'yet are searched all the same. Automatic is five frame intervals, at least 1 s.',
        'number', unit='s', minimum=0.0, live=True, optional=True),
    NodeParameter(
        'queue_length', 0, 'Frames that may wait while a batch is searched; the oldest are '
        'dropped, so that results stay recent. Automatic is two batches.', 'integer',
        unit='frames', minimum=0, live=True, optional=True),
    NodeParameter(
        'frame_height', 0, 'Height of the frames; with frame_width and frame_rate_hz the search '
        'is prepared before the first frame arrives, with preset auto only compiled. Automatic '
        'waits for frames.', 'integer',
        unit='px', minimum=0, optional=True),
    NodeParameter(
        'frame_width', 0, 'Width of the frames; see frame_height.', 'integer', unit='px',
        minimum=0, optional=True),
    NodeParameter(
        'frame_rate_hz', 0.0, 'Frames per second; see frame_height.', 'number', unit='Hz',
        minimum=0.0, optional=True),
    NodeParameter(
        'stamp_source', HEADER, 'Where the stamps of frames come from: their header, their '
        'arrival by the clock of the node, or by a steady one that starts at the time of day and '
        'never jumps or stands still. Frames without header (topic frame) are stamped on arrival '
        'in any case.', 'text', choices=(HEADER, ARRIVAL, STEADY)),
    NodeParameter(
        'image_transport', RAW, 'Whether images come as they are, or as PNG or JPEG on the topic '
        'of the images with /compressed behind it.', 'text', choices=(RAW, COMPRESSED)),
    NodeParameter(
        'reliable', False, 'Whether to ask for lost frames to be sent again; a best-effort '
        'publisher is then not heard.', 'boolean'),
]


class DetectorNode(ParameterizedNode):
    """Wires subscriptions to the worker, and its results to publishers."""

    def __init__(self) -> None:
        super().__init__('detector', PARAMETERS)
        self._lock = threading.Lock()
        self._shown: set[int] = set()
        self._last_header = Header()
        self._warnings = Warnings()
        self._reception = Reception()
        self._library_log = LibraryLog(self._warn)
        self._log_state = ThrottledLog(lambda line: self.get_logger().info(line))
        self._log_change = ThrottledLog(lambda line: self.get_logger().info(line))
        self._logged_state = ('', 0.0)
        self._began_s = time.monotonic()
        self._create_outputs()
        self._sources = self._frame_sources()
        self._create_inputs()
        self.finish_parameters()
        values = self.values()
        shape = (values['frame_height'], values['frame_width'])
        rate = values['frame_rate_hz']
        known = min(shape) > 0 and rate > 0.0
        self._worker = StreamWorker(
            self._request,
            expected_shape=shape if known else None,
            expected_interval_s=1.0 / rate if known else None,
            on_result=self._publish, on_reset=self._clear_markers, on_state=self._state_changed,
            on_choice=self._log_choice, on_warning=self._warn)
        self._worker.start()

    def check_values(self, values: Mapping[str, Any], told: Set[str]) -> None:
        """Raise ParameterError when options do not go together, or not with the detector."""
        request = StreamRequest(
            values['preset'],
            option_values(PARAMETERS, {name: values[name] for name in values.keys() & told}),
            max_gap_s=values['max_gap_s'] or None, queue_length=values['queue_length'] or None,
            flush_after_s=values['flush_after_s'] or None)
        TrackingPipeline(request.unseen.options)
        # Kept, so that the files that options name are not read again for what comes next.
        self._request = request

    def on_change(self, names: list[str]) -> None:
        """Hand changed parameters to the worker, which uses them from the next batch on."""
        self._log_change(f'changed: {", ".join(names)}; in effect from the next batch on')
        self._worker.queue.configure(self._request)

    def stop(self) -> bool:
        """Stop the worker; return whether it stopped in time."""
        self._library_log.close()
        return self._worker.stop(STOP_TIMEOUT_S)

    def _frame_sources(self) -> list[tuple[str, type, Callable[[Any], StampedFrame]]]:
        """Return the topics of frames, the type of each, and what reads a message of it."""
        values = self.values()
        reader = FrameReader(
            values['stamp_source'], (values['frame_height'], values['frame_width']),
            self.get_clock(), self._warn)
        arrays = ('frame', Float32MultiArray, reader.multiarray)
        if values['image_transport'] == COMPRESSED:
            # Beside the topic of the images wherever that is remapped to, as its senders have it.
            return [(f'{self.resolve_topic_name("image")}/compressed', CompressedImage,
                     reader.compressed_image), arrays]
        return [('image', Image, reader.image), arrays]

    def _create_inputs(self) -> None:
        reliability = (QoSReliabilityPolicy.RELIABLE if self.values()['reliable']
                       else QoSReliabilityPolicy.BEST_EFFORT)
        qos = QoSProfile(depth=INPUT_DEPTH, reliability=reliability,
                         durability=QoSDurabilityPolicy.VOLATILE)
        for topic, kind, read in self._sources:
            with self.overridable_qos():
                self.create_subscription(
                    kind, topic, partial(self._take, read), qos,
                    event_callbacks=self._event_callbacks(topic),
                    qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def _create_outputs(self) -> None:
        def publisher(kind: type, topic: str) -> Publisher:
            return self.create_publisher(kind, topic, OUTPUT_DEPTH)
        self._markers = publisher(MarkerArray, 'trajectories/markers')
        self._paths = publisher(Path, 'trajectories/path')
        self._points = publisher(PointCloud2, 'trajectories/points')
        self._overlay = publisher(Image, 'overlay')
        self._diagnostics = publisher(DiagnosticArray, '/diagnostics')
        self.create_service(Trigger, '~/flush', self._flush)
        # Diagnostics must go on when a simulated clock stands still.
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._look_around,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _event_callbacks(self, topic: str) -> SubscriptionEventCallbacks:
        def incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
            self._reception.n_incompatible += event.total_count_change
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._warn(f'qos {topic}', (
                f'a publisher on {topic!r} offers a quality of service ({policy}) that this '
                'node cannot take, so nothing is received from it; set the parameter reliable '
                'to what the publisher offers'))

        def lost(event: QoSMessageLostInfo) -> None:
            self._reception.n_lost += event.total_count_change
            self._warn(f'lost {topic}', (f'{event.total_count} messages on {topic!r} were lost'
                                          f'{larger_segment_words()}'))

        return SubscriptionEventCallbacks(incompatible_qos=incompatible, message_lost=lost)

    def _take(self, read: Callable[[Any], StampedFrame], message: Any) -> None:
        queue = self._worker.queue
        try:
            frame = read(message)
        except TbdError as error:
            queue.refuse_message()
            self._warn('message', f'message refused: {error}')
            return
        if queue.put(frame.pixels, frame.stamp_s, frame.header):
            busy = ('searching cannot keep up' if self._worker.status.state == 'ready' else
                    f'frames come while the search is made ready ({self._worker.status.state})')
            self._warn('dropped', (
                f'{busy}: {queue.counters.dropped} of '
                f'{queue.counters.received} frames were dropped so far'))

    def _flush(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._worker.queue.flush()
        response.success = True
        response.message = 'the frames that were in no batch yet are being searched'
        return response

    def _publish(self, result: StreamResult) -> None:
        trajectories = result.detection.trajectories
        header = result.tags[int(result.batch.frame_indices[-1])]
        stamps = {index: tag.stamp for index, tag in result.tags.items()}
        lifetime_s = LIFETIME_BATCHES * result.hop * (result.interval_s or 1.0)
        if trajectories:
            number = len(trajectories)
            self.get_logger().info(
                f'{number} {"trajectory" if number == 1 else "trajectories"} now',
                throttle_duration_sec=TRACKED_PERIOD_S)
        with self._lock:
            shown = {trajectory.id for trajectory in trajectories}
            ended, self._shown = self._shown - shown, shown
            self._last_header = header
        detection = result.detection
        if detection.status != 'converged':
            self._warn(f'status {detection.status}', '; '.join(
                [STATUSES[detection.status], *detection.remarks]))
        self._send(self._markers, conversions.markers_from_trajectories(
            trajectories, header, lifetime_s, sorted(ended)))
        for path in conversions.paths_from_trajectories(trajectories, header, stamps):
            self._send(self._paths, path)
        self._send(self._points, conversions.points_from_trajectories(trajectories, header))
        if self.context.ok() and self._overlay.get_subscription_count():
            pixels = render_overlay(result.batch.frames[-1], trajectories)
            self._send(self._overlay, conversions.image_from_colours(pixels, header))

    def _send(self, publisher: Publisher, message: Any) -> None:
        try:
            publisher.publish(message)
        except (RCLError, InvalidHandle):
            # An interrupt may take the middleware away while the search goes on.
            if self.context.ok():
                raise

    def _clear_markers(self) -> None:
        with self._lock:
            ended, self._shown = sorted(self._shown), set()
            header = self._last_header
        if ended:
            self._send(self._markers,
                       conversions.markers_from_trajectories([], header, 0.0, ended))

    def _state_changed(self) -> None:
        status = self._worker.status
        last_state, last_s = self._logged_state
        now_s = time.monotonic()
        if status.state == last_state and now_s - last_s < PROGRESS_PERIOD_S:
            return
        self._logged_state = (status.state, now_s)
        if status.state == 'failed':
            self.get_logger().error(f'{status.state}: {status.detail}')
        else:
            self._log_state(f'{status.state}: {status.detail}')
        self._publish_diagnostics()

    def _log_choice(self) -> None:
        status = self._worker.status
        for reason in status.reasons:
            self.get_logger().info(f'preset {status.preset}: {reason}')
        self.get_logger().info(f'options: {option_words(status.options)}')

    def _warn(self, kind: str, text: str) -> None:
        """Show a warning in the diagnostics, and log it unless its kind was logged just now."""
        with self._lock:
            is_new = self._warnings.add(kind, text)
        if is_new:
            self.get_logger().warning(text)

    def _look_around(self) -> None:
        """Warn of what is wrong around the node, log what was held back, say how it is."""
        topics = [topic for topic, *_ in self._sources]
        self._reception.n_senders = len(senders(self, topics))
        for kind, text in neighbour_warnings(self, topics).items():
            self._warn(kind, text)
        if (self.get_parameter('use_sim_time').value and not self.get_clock().now().nanoseconds
                and time.monotonic() - self._began_s > CLOCK_TIMEOUT_S):
            self._warn('clock', 'use_sim_time is set, but no time came on /clock: is the bag '
                       'played with --clock, or the simulation running?')
        self._log_state.catch_up()
        self._log_change.catch_up()
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        queue = self._worker.queue
        self._send(self._diagnostics, diagnostics_message(
            self.get_fully_qualified_name().lstrip('/'), self.get_clock().now().to_msg(),
            copy(self._worker.status), copy(queue.counters), len(queue), self._reception,
            self._warnings))


def spin_and_stop(node: DetectorNode, spin: Callable[[Node], None] = rclpy.spin) -> None:
    """Spin a node until it is interrupted, and wait for its search to stop."""
    try:
        spin(node)
    finally:
        # The second interrupt under ros2 launch must not cut the wait for the search short.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if not node.stop():
            # A compilation cannot be interrupted, and leaving Python under it would crash.
            sys.stderr.flush()
            os._exit(0)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run('detector', DetectorNode, spin_and_stop, args)


if __name__ == '__main__':
    sys.exit(main())
