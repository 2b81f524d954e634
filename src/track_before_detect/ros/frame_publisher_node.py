"""Node ``frame_publisher``: plays a recording or a simulated scenario.

Topics (relative): out ``image`` (sensor_msgs/Image) or ``frame`` (std_msgs/Float32MultiArray),
``truth/path`` (nav_msgs/Path, one message per true target) where the truth is known,
``/diagnostics``, and ``/clock`` when asked for. Services (std_srvs/Trigger) are named like those
of ``ros2 bag play``: ``~/pause``, ``~/resume``, ``~/toggle_paused``, ``~/is_paused``,
``~/play_next``, ``~/play``, ``~/stop``, ``~/seek`` and ``~/seek_frame``.
"""

from collections.abc import Callable, Mapping, Set
import time
from typing import Any, SupportsFloat

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import Image
from std_msgs.msg import Float32MultiArray, Header
from std_srvs.srv import Trigger

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.ros import conversions
from track_before_detect.ros.diagnostics import status_message
from track_before_detect.ros.executables.ending import Ending
from track_before_detect.ros.logs.qos_events import output_events
from track_before_detect.ros.parameters import NodeParameter, ParameterizedNode
from track_before_detect.ros.playback.played import open_played
from track_before_detect.ros.playback.playhead import Playhead

OUTPUT_DEPTH = 20
ACKNOWLEDGE_TIMEOUT_S = 5.0
# Best-effort readers acknowledge nothing; what was sent still needs a moment to arrive.
LINGER_S = 0.5
IDLE_S = 0.2
WAITING_LOG_PERIOD_S = 5.0
LATE_S = 0.5
DIAGNOSTICS_PERIOD_S = 1.0
LEAST_CLOCK_HZ = 0.001

PARAMETERS = [
    NodeParameter(
        'input', '', 'Recording to play: .npz, a folder of images, multi-page TIFF, FITS cube, '
        'video or rosbag2; empty plays the scenario.', 'text'),
    NodeParameter(
        'topic', '', 'Topic of a bag; empty takes the only suitable one.', 'text'),
    NodeParameter(
        'scenario', 'eo_ir_drones', 'Simulated scenario (tbd simulate --list names them).',
        'text'),
    NodeParameter(
        'seed', 0, 'Random seed of the scenario.', 'integer', minimum=0),
    NodeParameter(
        'scenario_set', '', 'Parameters of the scenario to change, as KEY=VALUE with spaces '
        'between them (tbd simulate --list explains them).', 'text'),
    NodeParameter(
        'message', 'image', 'What is published: image is sensor_msgs/Image, frame is '
        'std_msgs/Float32MultiArray.', 'text', choices=('image', 'frame')),
    NodeParameter(
        'rate_hz', 0.0, 'Frames per second. Automatic keeps the original intervals.', 'number',
        unit='Hz', minimum=0.0, maximum=10000.0, optional=True),
    NodeParameter(
        'rate', 1.0, 'How many times faster than that frames are played.', 'number', above=0.0,
        maximum=1000.0, live=True),
    NodeParameter(
        'loop', False, 'Whether to start again after the last frame.', 'boolean', live=True),
    NodeParameter(
        'start_offset_s', 0.0, 'Where playing starts, in seconds from the first frame at rate 1.',
        'number', unit='s', minimum=0.0, live=True),
    NodeParameter(
        'playback_duration_s', 0.0, 'How much is played from there. Automatic is all.', 'number',
        unit='s', minimum=0.0, live=True, optional=True),
    NodeParameter(
        'start_paused', False, 'Whether to wait for the service resume or play_next.', 'boolean'),
    NodeParameter(
        'step_frames', 1, 'Frames that the service play_next plays.', 'integer', minimum=1,
        live=True),
    NodeParameter(
        'seek_s', 0.0, 'Where the service seek goes, in seconds from the first frame at rate 1.',
        'number', unit='s', minimum=0.0, live=True),
    NodeParameter(
        'seek_frame', 0, 'Frame to which the service seek_frame goes, the first is 0.', 'integer',
        minimum=0, live=True),
    NodeParameter(
        'clock_hz', 0.0, 'How often /clock is published besides with every frame, with the time '
        'of the stamps; 0 never publishes it.', 'number', unit='Hz', minimum=0.0,
        maximum=1000.0),
    NodeParameter(
        'original_stamps', False, 'Whether frames carry the stamps of the recording instead of '
        'the time they are due; in a loop these jump back.', 'boolean'),
    NodeParameter(
        'frame_id', '', "Coordinate frame in the header; empty takes the recording's, or "
        "'camera'.", 'text'),
    NodeParameter(
        'wait_for_subscriber', True, 'Whether to wait for a subscriber before the first frame.',
        'boolean'),
    NodeParameter(
        'reliable', True, 'Whether to offer that lost frames are sent again; best-effort '
        'subscribers are served all the same.', 'boolean'),
    NodeParameter(
        'exit_when_done', True, 'Whether to exit after the last frame.', 'boolean'),
]


class FramePublisherNode(ParameterizedNode):
    """Publishes one frame whenever it is due; :meth:`step` is called in a loop.

    Parameters
    ----------
    name, **settings
        As of :class:`ParameterizedNode`.
    """

    # What check_values asks first when nothing is open yet.
    _is_open = False

    def __init__(self, name: str = 'frame_publisher', **settings: Any) -> None:
        super().__init__(name, PARAMETERS, **settings)
        self._values = values = self.values()
        self._played = played = open_played(values, self.get_logger().warning)
        self._is_open = True
        self._head = Playhead(played.positions, played.interval_s, values['start_paused'])
        self.check_values(values, set())
        self._set_pace(0.0)
        # What cannot be sent is said at once, not in the middle of playing.
        conversions.sendable(np.asarray(played.frames[0]))
        conversions.time_from_seconds(float(played.stamps[-1]))
        self._as_image = values['message'] == 'image'
        if not self._as_image and values['original_stamps'] and played.stamps[0] < 0:
            raise DataError(
                'the label that stamps a message of message=frame holds no stamp below 0 s, got '
                f'{played.stamps[0]:g} s: take message=image or original_stamps=false')
        self.finished = self._begun = False
        self._n_published = self._n_late = self._n_rounds = self._n_clocks = 0
        self._ahead_s = 0.0
        self._waiting_logged_s = -np.inf
        self._create_outputs()
        self._create_services()
        self.finish_parameters()
        self.get_logger().info('{}: {} frames of {} x {}, {}'.format(
            played.title, len(played.stamps), *played.frames[0].shape, played.pace))

    def step(self) -> float:
        """Publish the next frame if it is due; return the seconds until there is more to do."""
        if self.finished or not self._has_begun():
            return IDLE_S
        now_s, head = time.monotonic(), self._head
        if head.is_over:
            self._end_round(now_s)
            return 0.0
        due_s = head.due_s()
        if now_s < due_s:
            return due_s - now_s
        if now_s - due_s > LATE_S:
            self._n_late += 1
            self.get_logger().warning(
                f'frame {head.next} is {now_s - due_s:.1f} s late: reading or sending cannot '
                'keep up with the rate', throttle_duration_sec=5.0)
        self._publish(head.next)
        head.pass_frame(now_s)
        return 0.0

    def destroy_node(self) -> None:
        """Close the recording, then destroy the node."""
        self._played.close()
        super().destroy_node()

    def check_values(self, values: Mapping[str, Any], told: Set[str]) -> None:
        """Raise ParameterError where nothing would be played, or the clock would stand still."""
        if 0 < values['clock_hz'] < LEAST_CLOCK_HZ:
            raise ParameterError(f'clock_hz must be 0 or at least {LEAST_CLOCK_HZ:g}, got '
                                 f'{values["clock_hz"]:g}')
        if self._is_open:
            first, stop = self._limits(values)
            if first >= stop:
                raise ParameterError(
                    f'start_offset_s ({values["start_offset_s"]:g}) and playback_duration_s '
                    f'({values["playback_duration_s"]:g}) must leave a frame, but they lie at 0 '
                    f'to {self._played.positions[-1]:g} s')

    def on_change(self, names: list[str]) -> None:
        """Go on with what was changed."""
        self._values = self.values()
        self.get_logger().info(
            f'changed: {", ".join(f"{name}={self._values[name]}" for name in names)}')
        self._set_pace(time.monotonic())
        self._anchored()

    @property
    def exits(self) -> bool:
        """Whether the process is to end now that everything was published."""
        return self.finished and self._values['exit_when_done']

    def _limits(self, values: Mapping[str, Any]) -> tuple[int, int]:
        start_s = values['start_offset_s']
        return self._head.frames_between(
            start_s, start_s + (values['playback_duration_s'] or np.inf))

    def _set_pace(self, now_s: float) -> None:
        self._head.set_rate(self._values['rate'], now_s)
        self._head.limit(*self._limits(self._values), now_s)

    def _create_outputs(self) -> None:
        reliability = (QoSReliabilityPolicy.RELIABLE if self._values['reliable']
                       else QoSReliabilityPolicy.BEST_EFFORT)
        qos = QoSProfile(depth=OUTPUT_DEPTH, reliability=reliability,
                         durability=QoSDurabilityPolicy.VOLATILE)
        kind, topic = (Image, 'image') if self._as_image else (Float32MultiArray, 'frame')

        def unheard(policy: str) -> None:
            self.get_logger().warning(
                f'a subscriber of {topic!r} asks for a quality of service ({policy}) that is not '
                'offered, so it receives nothing; set the parameter reliable to true')

        with self.overridable_qos():
            self._frame_publisher = self.create_publisher(
                kind, topic, qos, event_callbacks=output_events(unheard),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
        # Kept for those who come late: the truth is sent when playing starts or is changed.
        self._truth_publisher = self.create_publisher(Path, 'truth/path', QoSProfile(
            depth=max(1, len(self._played.truth)), reliability=QoSReliabilityPolicy.RELIABLE,
            durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', OUTPUT_DEPTH)
        # Both must go on when a simulated clock stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=steady)
        self._clock_publisher = None
        if self._values['clock_hz']:
            self._clock_publisher = self.create_publisher(ClockMessage, '/clock', 1)
            self.create_timer(1.0 / self._values['clock_hz'], self._publish_clock, clock=steady)

    def _create_services(self) -> None:
        for act in (self._pause, self._resume, self._toggle_paused, self._is_paused,
                    self._play_next, self._play, self._stop, self._seek, self._seek_frame):
            self.create_service(Trigger, f'~/{act.__name__[1:]}', self._answering(act))

    def _answering(self, act: Callable[[float], str | None]
                   ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        """Return what serves: an act at a time, which returns why it was not done."""
        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            refusal = act(time.monotonic())
            response.success = not refusal
            response.message = refusal or self._state_words()
            if not refusal:
                self._anchored()
            return response
        return serve

    def _pause(self, now_s: float) -> str | None:
        self._head.pause(now_s)
        return None

    def _resume(self, now_s: float) -> str | None:
        self._head.resume(now_s)
        return 'done: call play or seek' if self.finished else None

    def _toggle_paused(self, now_s: float) -> str | None:
        return (self._resume if self._head.paused else self._pause)(now_s)

    def _is_paused(self, _: float) -> str | None:
        return None if self._head.paused else self._state_words()

    def _play_next(self, now_s: float) -> str | None:
        if not self._head.paused:
            return 'not paused: call pause before'
        if self._head.is_over:
            return 'done: call play or seek'
        self._head.play_next(self._values['step_frames'], now_s)
        return None

    def _play(self, now_s: float) -> str | None:
        self._head.resume(now_s)
        return self._go_to(self._limits(self._values)[0], now_s)

    def _stop(self, _: float) -> str | None:
        self._finish()
        return None

    def _seek(self, now_s: float) -> str | None:
        frame, _ = self._head.frames_between(self._values['seek_s'], np.inf)
        return self._go_to(frame, now_s)

    def _seek_frame(self, now_s: float) -> str | None:
        return self._go_to(self._values['seek_frame'], now_s)

    def _go_to(self, frame: int, now_s: float) -> str | None:
        first, stop = self._limits(self._values)
        if not first <= frame < stop:
            return f'frame {frame} is not among those played, {first} to {stop - 1}'
        self._head.seek(frame, now_s)
        self.finished = False
        return None

    def _state_words(self) -> str:
        state = ('done' if self.finished else 'waiting for a subscriber' if not self._begun
                 else 'paused' if self._head.paused else 'playing')
        return f'{state}, next is frame {self._head.next} of {len(self._played.stamps)}'

    def _has_begun(self) -> bool:
        if not self._begun and not self._must_wait():
            now_s = time.monotonic()
            self._begun = True
            self._head.seek(self._head.next, now_s)
            self._anchored()
        return self._begun

    def _must_wait(self) -> bool:
        waits = self._values['wait_for_subscriber']
        if not waits or self._frame_publisher.get_subscription_count():
            return False
        now_s = time.monotonic()
        if now_s - self._waiting_logged_s > WAITING_LOG_PERIOD_S:
            self._waiting_logged_s = now_s
            self.get_logger().info(
                f'waiting for a subscriber of {self._frame_publisher.topic_name}')
        return True

    def _anchored(self) -> None:
        """Read the clock, and send the truth with the stamps that frames will have from now on."""
        self._ahead_s = 1e-9 * self.get_clock().now().nanoseconds - time.monotonic()
        if not self._begun or self._head.paused or self.finished:
            return
        for rows in self._played.truth:
            stamps_s = self._stamps_s(self._played.positions[rows[:, 0].astype(int)])
            self._truth_publisher.publish(conversions.path_from_positions(
                rows[:, 2:], stamps_s, self._header(stamps_s[0])))

    def _stamps_s(self, positions_s: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the stamps of frames at positions: those of the recording, or when due."""
        if self._values['original_stamps']:
            return np.asarray(
                np.interp(positions_s, self._played.positions, self._played.stamps))
        return self._ahead_s + self._head.times_s(positions_s)

    def _end_round(self, now_s: float) -> None:
        self._n_rounds += 1
        if self._values['loop']:
            self._head.start_again(now_s)
            self._anchored()
        else:
            self._finish()

    def _finish(self) -> None:
        self.get_logger().info(
            f'done: {self._n_published} frames published, {self._n_late} of them late')
        self._frame_publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))
        self.finished = True

    def _header(self, stamp_s: SupportsFloat) -> Header:
        return Header(stamp=conversions.time_from_seconds(float(stamp_s)),
                      frame_id=self._played.frame_id)

    def _publish(self, index: int) -> None:
        frame = conversions.sendable(np.asarray(self._played.frames[index]))
        header = self._header(self._stamps_s(self._played.positions[index]))
        message = (conversions.image_from_frame if self._as_image
                   else conversions.multiarray_from_frame)(frame, header)
        # First, so that no frame is of the future.
        self._publish_clock()
        self._frame_publisher.publish(message)
        self._n_published += 1

    def _publish_clock(self) -> None:
        if self._clock_publisher is not None and self._begun:
            stamp_s = self._stamps_s(self._head.position_s(time.monotonic()))
            self._clock_publisher.publish(
                ClockMessage(clock=conversions.time_from_seconds(float(stamp_s))))
            self._n_clocks += 1

    def _publish_diagnostics(self) -> None:
        now_s = time.monotonic()
        self._diagnostics.publish(status_message(
            self.get_fully_qualified_name().lstrip('/'), self.get_clock().now().to_msg(),
            self._state_words(), {
                'next_frame': self._head.next,
                'frames': len(self._played.stamps),
                'position_s': f'{self._head.position_s(now_s):.3f}',
                'paused': str(self._head.paused).lower(),
                'rate': f'{self._head.rate:g}',
                'rounds': self._n_rounds,
                'frames_published': self._n_published,
                'frames_late': self._n_late,
                'clock_messages': self._n_clocks,
                'subscribers': self._frame_publisher.get_subscription_count(),
            }))


def play(node: FramePublisherNode, executor: SingleThreadedExecutor, ending: Ending) -> None:
    """Publish until everything was published or a signal has come."""
    while not (ending.requested or node.exits):
        executor.spin_once(timeout_sec=min(node.step(), IDLE_S))
    end_s = time.monotonic() + LINGER_S
    while not ending.requested and time.monotonic() < end_s:
        executor.spin_once(timeout_sec=LINGER_S)
