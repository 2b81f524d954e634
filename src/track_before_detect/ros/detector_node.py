"""Node ``detector``: frames in, trajectories out.

Topics (relative): in ``image`` (sensor_msgs/Image) or ``image/compressed``, and ``frame``
(std_msgs/Float32MultiArray), or those of several sensors; out ``trajectories/markers``,
``trajectories/path``, ``trajectories/points``, ``overlay``, ``/diagnostics`` and, where their
packages are installed, those of :class:`FieldOutputs`. Service ``~/flush`` (std_srvs/Trigger) has
the frames that were in no batch yet searched at once. The node is managed: it searches while it
is active, see docs/nodes/detector.md.
"""

from collections.abc import Callable, Mapping, Sequence, Set
from copy import copy
from functools import partial
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.qos_overriding_options import _declare_qos_parameters, QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Float32MultiArray, Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from track_before_detect.errors import ParameterError, TbdError
from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.overlay import render_overlay
from track_before_detect.ros import conversions
from track_before_detect.ros.beside import StreamPipeline
from track_before_detect.ros.diagnostics import (
    diagnostics_message,
    option_words,
    Reception,
    Warnings,
)
from track_before_detect.ros.frame_queue import LookedAt, StreamRequest
from track_before_detect.ros.intake.camera import Camera
from track_before_detect.ros.intake.camera_input import CAMERA_PARAMETERS, CameraInput, UNKNOWN
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
from track_before_detect.ros.intake.region import REGION, Region
from track_before_detect.ros.intake.sensor_inputs import (
    FRAME,
    IMAGE,
    parameters_of,
    sensor_inputs,
    SensorInput,
    SENSORS,
)
from track_before_detect.ros.intake.sensor_stream import SensorCount, SensorStream
from track_before_detect.ros.logs.library_log import LibraryLog
from track_before_detect.ros.logs.qos_events import input_events, output_events
from track_before_detect.ros.logs.throttled import ThrottledLog
from track_before_detect.ros.managed_node import (
    ACTIVE,
    AUTOSTART,
    FINALIZED,
    INACTIVE,
    ManagedNode,
    UNCONFIGURED,
)
from track_before_detect.ros.outputs.field_outputs import FieldOutputs, SCALE_PARAMETERS
from track_before_detect.ros.outputs.head import Head
from track_before_detect.ros.outputs.seen_targets import RadarScale
from track_before_detect.ros.outputs.stream_view import check_view, StreamView, VIEW
from track_before_detect.ros.parameters import (
    check_topic_name,
    NodeParameter,
    option_parameters,
    option_values,
)
from track_before_detect.ros.search_results import StreamResult
from track_before_detect.ros.worker import StreamWorker
from track_before_detect.tracking.batcher import DEFAULT_LENGTH
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.presets import AUTO, PRESETS
from track_before_detect.tracking.sensor_pipeline import SensorPipeline
from track_before_detect.tracking.sensors import seen_by, SensorPlane
from track_before_detect.types import STATUSES, Trajectory

BATCH, HEAD = 'batch', 'head'
INPUT_DEPTH = 20
OUTPUT_DEPTH = 50
DIAGNOSTICS_PERIOD_S = 1.0
PROGRESS_PERIOD_S = 2.0
TRACKED_PERIOD_S = 5.0
# Without a time of /clock until then somebody waits in vain.
CLOCK_TIMEOUT_S = 5.0
LIFETIME_BATCHES = 3.0
# Of the two seconds that a process may take to end.
STOP_TIMEOUT_S = 1.0

RCLError, InvalidHandle = rclpy_implementation.RCLError, rclpy_implementation.InvalidHandle

# Topic of frames, type of its messages, what reads one, and the number of the sensor.
Source = tuple[str, type, Callable[[Any], StampedFrame], int]

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
        'never jumps or stands still. Arrays (topic frame) have no header: they are stamped on '
        'arrival in any case but where the label of a dimension is stamp=SECONDS.NANOSECONDS '
        'frame_id=NAME.', 'text', choices=(HEADER, ARRIVAL, STEADY)),
    NodeParameter(
        'image_transport', RAW, 'Whether images come as they are, or as PNG or JPEG on the topic '
        'of the images with /compressed behind it.', 'text', choices=(RAW, COMPRESSED)),
    NodeParameter(
        'reliable', False, 'Whether to ask for lost frames to be sent again; a best-effort '
        'publisher is then not heard.', 'boolean'),
    NodeParameter(
        'publish', BATCH, 'Whether trajectories are published once a batch, or beside that, on '
        'trajectories/head, where each target of the last batch is at every new frame.', 'text',
        choices=(BATCH, HEAD)),
    REGION,
    *SENSORS,
    *CAMERA_PARAMETERS,
    *SCALE_PARAMETERS,
    VIEW,
    AUTOSTART,
]


class DetectorNode(ManagedNode):
    """Wires subscriptions to the worker, and its results to publishers.

    It may share an executor, and a process, with other nodes. Configured it has compiled its
    loops, and calibrated its threshold as far as options allow before a first frame.

    Parameters
    ----------
    name, **settings
        As of :class:`ParameterizedNode`.
    """

    _sensors: Sequence[SensorInput] = ()
    _region: Region | None = None
    _view: StreamView | None = None

    def __init__(self, name: str = 'detector', **settings: Any) -> None:
        super().__init__(name, PARAMETERS, **settings)
        self._lock = threading.Lock()
        self._shown: set[int] = set()
        self._last_header = Header()
        self._frame_id = ''
        self._warnings = Warnings(self.get_logger().warning)
        self._warn = self._warnings.add
        self._reception = Reception()
        self._library_log = LibraryLog(self._warn)
        self._log_state, self._log_change, self._log_choice = (
            ThrottledLog(lambda line: self.get_logger().info(line)) for _ in range(3))
        self._logged_state = ('', ''), 0.0
        self._began_s = time.monotonic()
        self._active = self._ending = False
        self._inputs: list[Subscription] = []
        self._worker = self._make_worker()
        self._create_outputs()
        self._sources = self._frame_sources()
        self._camera: CameraInput | None = None
        if self.values()['camera_info']:
            self._camera = CameraInput(self.values()['camera_info'],
                                       self.values()['camera_rectified'], self._warn)
            self._rays = self._create_output(MarkerArray, 'trajectories/rays')
        self._declare_inputs()
        self.finish_parameters()
        self._field_outputs = FieldOutputs(self._create_output, self.values())
        self._head: tuple[Head, Publisher] | None = None
        if self.values()['publish'] == HEAD:
            self._head = Head(), self._create_output(PointCloud2, 'trajectories/head')
        if self.values()['autostart']:
            self.start_up()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Prepare the search; return once that is done."""
        self._view = self._make_view()
        self._worker = self._make_worker()
        self._field_outputs.reset()
        if self._ending:
            return TransitionCallbackReturn.FAILURE
        if self._view is not None:
            self._view.start()
        self._worker.start()
        if not self._worker.wait_until_prepared():
            if not self._ending:
                self._stop_search()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Search from now on, and subscribe to frames unless that was done before."""
        result = super().on_activate(state)
        self._active = True
        if not self._inputs:
            # Last, so that a publisher that waits for somebody to listen loses nothing.
            self._create_inputs()
        self.get_logger().info(f'{ACTIVE}: frames are searched')
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop frames from now on, those that wait included; remove what was shown."""
        self._active = False
        self._worker.queue.discard()
        self._clear_markers()
        self.get_logger().info(f'{INACTIVE}: frames are counted and dropped')
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the search and its counters."""
        self._release()
        self._worker = self._make_worker()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the search for good."""
        self._active = False
        self._release()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning."""
        self.get_logger().error(f'a transition from {state.label} failed')
        return self.on_shutdown(state)

    def destroy_node(self) -> None:
        """Stop the search, waiting for it a moment, then destroy the node."""
        self._active, self._ending = False, True
        self._stop_search()
        self.wait_for_start(STOP_TIMEOUT_S)
        self._library_log.close()
        super().destroy_node()

    def further_parameters(self, values: Mapping[str, Any]) -> list[NodeParameter]:
        """Return the parameters of each of several sensors."""
        return parameters_of(values['sensors'])

    def check_values(self, values: Mapping[str, Any], told: Set[str]) -> None:
        """Raise ParameterError when options do not go together, or not with the detector."""
        self._sensors = self._sensors or sensor_inputs(values)
        request = StreamRequest(
            values['preset'],
            option_values(PARAMETERS, {name: values[name] for name in values.keys() & told}),
            max_gap_s=values['max_gap_s'] or None, queue_length=values['queue_length'] or None,
            flush_after_s=values['flush_after_s'] or None, sensors=tuple(
                LookedAt(one.name, one.shape, one.view.noise_sigma) for one in self._sensors))
        self._make_pipeline(request.unseen.options, None)
        check_view(values)
        RadarScale.of(values)
        region = Region.of({**values, 'doppler_ambiguities':
                            request.unseen.options.doppler_ambiguities})
        # Kept once it is known: it cuts frames already while other parameters change.
        self._region = self._region or region
        if values['camera_info']:
            check_topic_name(values['camera_info'], 'camera_info must be the name of a topic')
        if values['camera_info'] and self._sensors:
            raise ParameterError('camera_info tells of one sensor, got '
                                 f'{values["camera_info"]!r} beside {len(self._sensors)} sensors')
        if values['view'] and self._sensors:
            raise ParameterError(f'view shows one sensor, got {values["view"]!r} beside '
                                 f'{len(self._sensors)} sensors')
        # Kept, so that the files that options name are not read again for what comes next.
        self._request = request

    def on_change(self, names: list[str]) -> None:
        """Hand changed parameters to the worker, which uses them when they are prepared."""
        self._log_change(f'changed: {", ".join(names)}; in effect as soon as it is prepared')
        if self.lifecycle_state != UNCONFIGURED:
            self._worker.queue.configure(self._request)
        elif self._worker.status.state == 'failed' and self.values()['autostart']:
            self.start_up()

    def _make_worker(self) -> StreamWorker:
        """Return a worker that was not started yet, for what the parameters ask."""
        values = self.values()
        shape = (values['frame_height'], values['frame_width'])
        rate = values['frame_rate_hz']
        if self._region is not None:
            shape = self._region.shape
        self._stream = None
        if self._sensors:
            names, shapes = zip(*((one.name, one.shape) for one in self._sensors), strict=True)
            self._stream = SensorStream(names, shapes, values['sensor_wait_s'])
            # Nothing is calibrated for a rate, so that any will do.
            shape, rate = self._stream.shape, 1.0
        known = min(shape) > 0 and rate > 0.0
        return StreamWorker(
            self._request,
            expected_shape=shape if known else None,
            expected_interval_s=1.0 / rate if known else None,
            on_result=self._publish, on_reset=self._clear_markers, on_state=self._state_changed,
            on_choice=self._choice_made, on_warning=self._warn,
            make_pipeline=self._make_pipeline, sensors=self._stream)

    def _make_pipeline(self, options: DetectorOptions, earlier: Any) -> StreamPipeline:
        """Return what searches the batches of one sensor, or of several together."""
        if not self._sensors:
            return TrackingPipeline(
                options, earlier, observe=None if self._view is None else self._view.observe)
        views, shapes = zip(*((one.view, one.shape) for one in self._sensors), strict=True)
        return SensorPipeline(SensorPlane(views, shapes, options), options, earlier)

    def _make_view(self) -> StreamView | None:
        """Return a view that was not started yet, None where nothing is to be shown."""
        where = self.values()['view']
        return StreamView(where, lambda place: self.get_logger().info(f'view: {place}'),
                          self._warn) if where else None

    def _stop_search(self) -> None:
        """Stop the worker, and what shows its batches."""
        if self._view is not None:
            self._view.close()
        self._worker.stop(STOP_TIMEOUT_S)
        if self._view is not None:
            self._view.join(STOP_TIMEOUT_S)

    def _release(self) -> None:
        """Stop the search and unsubscribe from frames."""
        self._stop_search()
        while self._inputs:
            self.destroy_subscription(self._inputs.pop())

    def _input_qos(self) -> QoSProfile:
        reliability = (QoSReliabilityPolicy.RELIABLE if self.values()['reliable']
                       else QoSReliabilityPolicy.BEST_EFFORT)
        return QoSProfile(depth=INPUT_DEPTH, reliability=reliability,
                          durability=QoSDurabilityPolicy.VOLATILE)

    def _declare_inputs(self) -> None:
        """Check the overrides of quality of service at once, with the other parameters.

        Subscribing for a moment would tell publishers that somebody listens.
        """
        for topic, *_ in self._sources:
            with self.overridable_qos():
                _declare_qos_parameters(
                    Subscription, self, self.resolve_topic_name(topic), self._input_qos(),
                    QoSOverridingOptions.with_default_policies())

    def _create_inputs(self) -> None:
        for topic, kind, read, sensor in self._sources:
            self._inputs.append(self.create_subscription(
                kind, topic, partial(self._take, read, sensor), self._input_qos(),
                event_callbacks=self._event_callbacks(topic),
                qos_overriding_options=QoSOverridingOptions.with_default_policies()))
        if self._camera is not None:
            self._inputs.append(self.create_subscription(
                CameraInfo, self.values()['camera_info'], self._camera.take,
                QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)))

    def _create_output(self, kind: type, topic: str) -> Publisher:
        return self.create_lifecycle_publisher(
            kind, topic, OUTPUT_DEPTH, event_callbacks=self._output_events(topic))

    def _frame_sources(self) -> list[Source]:
        """Return the topics of frames, type and reader of their messages, and the sensor."""
        values = self.values()

        def source(topic: str, message: str, reader: FrameReader, sensor: int) -> Source:
            if message != IMAGE:
                return topic, Float32MultiArray, reader.multiarray, sensor
            if values['image_transport'] == COMPRESSED:
                # Beside the topic of the images wherever that is remapped to, as senders have it.
                return (f'{self.resolve_topic_name(topic)}/compressed', CompressedImage,
                        reader.compressed_image, sensor)
            return topic, Image, reader.image, sensor

        def reader(shape: tuple[int, int]) -> FrameReader:
            return FrameReader(values['stamp_source'], shape, self.get_clock(), self._warn)

        if self._sensors:
            return [source(one.topic, one.message, reader(one.shape), number)
                    for number, one in enumerate(self._sensors)]
        own = reader((values['frame_height'], values['frame_width']))
        return [source(message, message, own, 0) for message in (IMAGE, FRAME)]

    def _create_outputs(self) -> None:
        self._markers = self._create_output(MarkerArray, 'trajectories/markers')
        self._paths = self._create_output(Path, 'trajectories/path')
        self._points = self._create_output(PointCloud2, 'trajectories/points')
        self._overlay = self._create_output(Image, 'overlay')
        self._diagnostics = self.create_publisher(
            DiagnosticArray, '/diagnostics', OUTPUT_DEPTH,
            event_callbacks=self._output_events('/diagnostics'))
        self.create_service(Trigger, '~/flush', self._flush)
        # Diagnostics must go on when a simulated clock stands still.
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._look_around,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _event_callbacks(self, topic: str) -> SubscriptionEventCallbacks:
        def unheard(n_more: int, policy: str) -> None:
            self._reception.n_incompatible += n_more
            self._warn(f'qos {topic}', (
                f'a publisher on {topic!r} offers a quality of service ({policy}) that this '
                'node cannot take, so nothing is received from it; set the parameter reliable '
                'to what the publisher offers'))

        def lost(n_more: int, n_all: int) -> None:
            self._reception.n_lost += n_more
            self._warn(f'lost {topic}',
                       f'{n_all} messages on {topic!r} were lost{larger_segment_words()}')

        return input_events(lost, unheard)

    def _output_events(self, topic: str) -> PublisherEventCallbacks:
        return output_events(lambda policy: self._warn(f'qos {topic}', (
            f'a subscriber of {topic!r} asks for a quality of service ({policy}) that is not '
            'offered, so it receives nothing')))

    def _take(self, read: Callable[[Any], StampedFrame], sensor: int, message: Any) -> None:
        queue = self._worker.queue
        if self._stream is not None:
            # Here, for frames may have to wait for the search.
            self._stream.counts[sensor].arrive(time.monotonic())
        if not self._active:
            queue.drop_message()
            return
        try:
            frame = read(message)
            if self._region is not None:
                frame = frame._replace(pixels=self._region.cut(frame.pixels))
        except TbdError as error:
            queue.refuse_message()
            self._warn('message', f'message refused: {error}')
            return
        if not sensor:
            self._frame_id = frame.header.frame_id or (
                self._camera.frame_id if self._camera is not None else '')
        # What several sensors see is told in the coordinates of the first.
        frame.header.frame_id = self._frame_id
        if queue.put(frame.pixels, frame.stamp_s, frame.header, sensor):
            busy = ('searching cannot keep up' if self._worker.status.state == 'ready' else
                    f'frames come while the search is made ready ({self._worker.status.state})')
            self._warn('dropped', (
                f'{busy}: {queue.counters.dropped} of '
                f'{queue.counters.received} frames were dropped so far'))
        if self._head is not None:
            head, publisher = self._head
            targets = head.at(frame.stamp_s)
            if targets is not None:
                self._send(publisher, conversions.points_from_head(
                    targets, frame.header, self._camera_of(frame.pixels, frame.header)))

    def _flush(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._active
        if self._active:
            self._worker.queue.flush()
            response.message = 'the frames that were in no batch yet are being searched'
        else:
            response.message = f'nothing is searched, the node is {self.lifecycle_state}'
        return response

    def _publish(self, result: StreamResult) -> None:
        if not self._active:
            # It was being searched when the node was deactivated, which removed what was shown.
            return
        # The overlay is of what was searched.
        searched = result
        if self._region is not None:
            result = self._region.in_whole(result)
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
        if self._head is not None:
            self._head[0].update(result, self._worker.status.options)
        detection = result.detection
        if detection.status != 'converged':
            self._warn(f'status {detection.status}', '; '.join(
                [STATUSES[detection.status], *detection.remarks]))
        camera = self._camera_of(result.batch.frames[-1], header)
        self._send_markers(trajectories, header, lifetime_s, sorted(ended), camera)
        for path in conversions.paths_from_trajectories(trajectories, header, stamps):
            self._send(self._paths, path)
        self._send(self._points, conversions.points_from_trajectories(
            trajectories, header, camera))
        if self.context.ok() and self._overlay.get_subscription_count():
            pixels = render_overlay(*self._newest_frame(searched))
            self._send(self._overlay, conversions.image_from_colours(pixels, header))
        if self._view is not None:
            self._view.show(searched, is_late=len(self._worker.queue) > result.hop)
        if self.context.ok():
            for output, message in self._field_outputs.messages(
                    result, self._worker.status.options):
                self._send(output, message)

    def _send_markers(self, trajectories: Sequence[Trajectory], header: Header,
                      lifetime_s: float, ended: Sequence[int],
                      camera: Camera | None = None) -> None:
        self._send(self._markers, conversions.markers_from_trajectories(
            trajectories, header, lifetime_s, ended))
        if self._camera is not None:
            self._send(self._rays, conversions.rays_from_trajectories(
                trajectories, header, camera or UNKNOWN, lifetime_s, ended))

    def _camera_of(self, pixels: NDArray, header: Header) -> Camera | None:
        """Return what is known of the camera that took a frame, None where that is not asked."""
        if self._camera is None:
            return None
        shape = pixels.shape if self._region is None else self._region.frame_shape
        return self._camera.camera(shape, header.frame_id)

    def _newest_frame(self, result: StreamResult) -> tuple[NDArray, Sequence[Trajectory]]:
        """Return the newest frame of a batch, and the trajectories in its pixels."""
        frame, trajectories = result.batch.frames[-1], result.detection.trajectories
        if result.batch.taken is None:
            return frame, trajectories
        number = int(result.batch.taken[-1, 0])
        height, width = self._sensors[number].shape
        return frame[:height, :width], seen_by(number, self._sensors[number].view, trajectories)

    def _send(self, publisher: Publisher, message: Any) -> None:
        try:
            publisher.publish(message)
        except (RCLError, InvalidHandle):
            # The node may be destroyed while the search goes on.
            if self.context.ok() and not self._ending:
                raise

    def _clear_markers(self) -> None:
        if self._head is not None:
            self._head[0].clear()
        with self._lock:
            ended, self._shown = sorted(self._shown), set()
            header = self._last_header
        if ended:
            self._send_markers([], header, 0.0, ended)

    def _state_changed(self) -> None:
        status = self._worker.status
        # What it is ready for is news; how far a preparation is, every few seconds.
        state = status.state, status.detail * (status.state == 'ready')
        last_state, last_s = self._logged_state
        now_s = time.monotonic()
        if state == last_state and now_s - last_s < PROGRESS_PERIOD_S:
            return
        self._logged_state = state, now_s
        line = '; '.join(filter(None, [f'{status.state}: {status.detail}', status.beside]))
        if status.state == 'failed':
            self.get_logger().error(line)
        else:
            self._log_state(line)
        self._publish_diagnostics()

    def _choice_made(self) -> None:
        status = self._worker.status
        for reason in status.reasons:
            self._log_choice(f'preset {status.preset}: {reason}')
        self._log_choice(f'options: {option_words(status.options)}')

    def _look_around(self) -> None:
        """Warn of what is wrong around the node, log what was held back, say how it is."""
        topics = [topic for topic, *_ in self._sources]
        self._reception.n_senders = len(senders(self, topics))
        for streams in [[topic] for topic in topics] if self._sensors else [topics]:
            for kind, text in neighbour_warnings(self, streams).items():
                self._warn(kind, text)
        now_s = time.monotonic()
        for sensor, count in self._sensor_counts().items():
            if self._active and (silent_s := count.silent_s(now_s)):
                since = f'for {silent_s:.1f} s' if count.received else 'so far'
                self._warn(f'silent {sensor}', f'sensor {sensor} has sent nothing {since}; the '
                           'others are searched without it')
        if (self.get_parameter('use_sim_time').value and not self.get_clock().now().nanoseconds
                and time.monotonic() - self._began_s > CLOCK_TIMEOUT_S):
            self._warn('clock', 'use_sim_time is set, but no time came on /clock: is the bag '
                       'played with --clock, or the simulation running?')
        for log in (self._log_state, self._log_change, self._log_choice):
            log.catch_up()
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        queue, status = self._worker.queue, copy(self._worker.status)
        lifecycle = self.lifecycle_state
        if lifecycle in (UNCONFIGURED, INACTIVE, FINALIZED) and status.state != 'failed':
            status.state, status.detail = lifecycle, ''
        self._send(self._diagnostics, diagnostics_message(
            self.get_fully_qualified_name().lstrip('/'), self.get_clock().now().to_msg(),
            status, copy(queue.counters), len(queue), self._reception, self._warnings,
            self._sensor_counts(), region='' if self._region is None else str(self._region)))

    def _sensor_counts(self) -> dict[str, SensorCount]:
        """Return what came from each of several sensors, by name."""
        if self._stream is None:
            return {}
        return {one.name: count
                for one, count in zip(self._sensors, self._stream.counts, strict=True)}
