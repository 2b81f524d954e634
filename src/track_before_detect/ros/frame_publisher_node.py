"""Node ``frame_publisher``: plays a recording or a simulated scenario.

Topics (relative): out ``image`` (sensor_msgs/Image) or ``frame`` (std_msgs/Float32MultiArray), and
``truth/path`` (nav_msgs/Path, one message per true target) where the truth is known.
"""

import time
from typing import Any

from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, QoSOfferedIncompatibleQoSInfo
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import (
    qos_policy_name_from_kind,
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Image
from std_msgs.msg import Float32MultiArray, Header

from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.recording import Recording
from track_before_detect.ros import conversions
from track_before_detect.ros.executables.ending import Ending
from track_before_detect.ros.parameters import NodeParameter, ParameterizedNode
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.timestamps import increasing_frames

OUTPUT_DEPTH = 20
ACKNOWLEDGE_TIMEOUT_S = 5.0
# Best-effort readers acknowledge nothing; what was sent still needs a moment to arrive.
LINGER_S = 0.5
IDLE_S = 0.2
WAITING_LOG_PERIOD_S = 5.0
LATE_S = 0.5

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
        'message', 'image', 'What is published: image is sensor_msgs/Image, frame is '
        'std_msgs/Float32MultiArray.', 'text', choices=('image', 'frame')),
    NodeParameter(
        'rate_hz', 0.0, 'Frames per second. Automatic keeps the original intervals.', 'number',
        unit='Hz', minimum=0.0, maximum=10000.0, optional=True),
    NodeParameter(
        'loop', False, 'Whether to start again after the last frame.', 'boolean'),
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

    def __init__(self, name: str = 'frame_publisher', **settings: Any) -> None:
        self._recording: Recording | None = None
        super().__init__(name, PARAMETERS, **settings)
        self._open()
        self._create_outputs()
        self.finish_parameters()
        self.finished = False
        self._next = 0
        self._n_published = 0
        self._n_late = 0
        self._pass_start_s: float | None = None
        self._waiting_logged_s = -np.inf
        self.get_logger().info(
            '{}: {} frames of {} x {}, {}'.format(
                self._title, len(self._stamps), *self._frames[0].shape, self._rate_text()))

    def step(self) -> float:
        """Publish the next frame if it is due; return the seconds until there is more to do."""
        if self.finished:
            return IDLE_S
        now_s = time.monotonic()
        if self._pass_start_s is None:
            if self._must_wait(now_s):
                return IDLE_S
            self._start_pass(now_s)
        due_s = self._pass_start_s + self._offsets[self._next]
        if now_s < due_s:
            return due_s - now_s
        if now_s - due_s > LATE_S:
            self._n_late += 1
            self.get_logger().warning(
                f'frame {self._next} is {now_s - due_s:.1f} s late: reading or sending cannot '
                'keep up with the rate', throttle_duration_sec=5.0)
        self._publish(self._next)
        self._next += 1
        if self._next == len(self._stamps):
            self._end_pass()
        return 0.0

    def destroy_node(self) -> None:
        """Close the recording, then destroy the node."""
        if self._recording is not None:
            self._recording.close()
        super().destroy_node()

    def _open(self) -> None:
        self._values = values = self.values()
        self._frames: Recording | NDArray
        self._truth: NDArray | None
        self._frame_id = values['frame_id']
        if values['input']:
            self._recording = recording = open_recording(values['input'], values['topic'] or None)
            self._frames, self._title = recording, recording.name
            self._stamps, self._truth = self._playable(recording.stamps), recording.truth
            self._frame_id = self._frame_id or recording.frame_id
        elif values['topic']:
            raise DataError(
                f'topic ({values["topic"]!r}) belongs to a bag, but input names none')
        else:
            simulated = simulate(values['scenario'], values['seed'])
            self._frames, self._title = simulated.frames, (
                f'scenario {values["scenario"]}, seed {values["seed"]}')
            self._stamps, self._truth = simulated.stamps, simulated.truth
        self._frame_id = self._frame_id or 'camera'
        self._as_image = values['message'] == 'image'
        self._offsets = self._times_of_pass()
        # What cannot be sent is said at once, not in the middle of playing.
        conversions.sendable(self._frames[0])
        conversions.time_from_seconds(float(self._stamps[-1]))

    def _playable(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return stamps that never jump back, wrong ones replaced by what lies between others."""
        increasing = increasing_frames(stamps)
        n_wrong = len(stamps) - len(increasing)
        if not n_wrong:
            return stamps
        self.get_logger().warning(
            f'{n_wrong} of {len(stamps)} stamps do not increase; their frames are played between '
            'those around them')
        return np.interp(np.arange(len(stamps)), increasing, stamps[increasing])

    def _times_of_pass(self) -> NDArray[np.float64]:
        """Return when each frame is due, in seconds from the start of a pass."""
        if self._values['rate_hz']:
            return np.arange(len(self._stamps)) / self._values['rate_hz']
        return self._stamps - self._stamps[0]

    def _rate_text(self) -> str:
        if self._values['rate_hz']:
            return f'{self._values["rate_hz"]:g} frames per second'
        if self._recording is not None and not self._recording.stamps_known:
            return 'without stamps, so one frame per second (set rate_hz for another rate)'
        return f'over {self._offsets[-1]:.2f} s as recorded'

    def _create_outputs(self) -> None:
        reliability = (QoSReliabilityPolicy.RELIABLE if self._values['reliable']
                       else QoSReliabilityPolicy.BEST_EFFORT)
        qos = QoSProfile(depth=OUTPUT_DEPTH, reliability=reliability,
                         durability=QoSDurabilityPolicy.VOLATILE)
        kind, topic = (Image, 'image') if self._as_image else (Float32MultiArray, 'frame')

        def incompatible(event: QoSOfferedIncompatibleQoSInfo) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self.get_logger().warning(
                f'a subscriber of {topic!r} asks for a quality of service ({policy}) that is not '
                'offered, so it receives nothing; set the parameter reliable to true')

        with self.overridable_qos():
            self._frame_publisher = self.create_publisher(
                kind, topic, qos, event_callbacks=PublisherEventCallbacks(
                    incompatible_qos=incompatible),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
        self._truth_rows = (
            [] if self._truth is None
            else [self._truth[self._truth[:, 1] == target]
                  for target in np.unique(self._truth[:, 1])])
        # Kept for those who come late: the truth is sent once per pass.
        self._truth_publisher = self.create_publisher(Path, 'truth/path', QoSProfile(
            depth=max(1, len(self._truth_rows)), reliability=QoSReliabilityPolicy.RELIABLE,
            durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))

    def _must_wait(self, now_s: float) -> bool:
        waits = self._values['wait_for_subscriber']
        if not waits or self._frame_publisher.get_subscription_count():
            return False
        if now_s - self._waiting_logged_s > WAITING_LOG_PERIOD_S:
            self._waiting_logged_s = now_s
            self.get_logger().info(
                f'waiting for a subscriber of {self._frame_publisher.topic_name}')
        return True

    def _start_pass(self, now_s: float) -> None:
        self._pass_start_s = now_s
        start_s = 1e-9 * self.get_clock().now().nanoseconds + now_s - time.monotonic()
        self._pass_stamps = (self._stamps if self._values['original_stamps']
                             else start_s + self._offsets)
        for rows in self._truth_rows:
            frames = rows[:, 0].astype(int)
            known = (frames >= 0) & (frames < len(self._stamps))
            stamps_s = self._pass_stamps[frames[known]]
            if not len(stamps_s):
                continue
            self._truth_publisher.publish(conversions.path_from_positions(
                rows[known, 2:], stamps_s, self._header(stamps_s[0])))

    def _end_pass(self) -> None:
        self._next = 0
        if self._values['loop']:
            # The first frame is due one interval after the last one.
            if len(self._offsets) > 1:
                interval_s = float(np.median(np.diff(self._offsets)))
            else:
                interval_s = 1.0 / (self._values['rate_hz'] or 1.0)
            self._pass_start_s += self._offsets[-1] + interval_s
            self._start_pass(self._pass_start_s)
            return
        self.get_logger().info(
            f'done: {self._n_published} frames published, {self._n_late} of them late')
        self._frame_publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))
        self.finished = True

    @property
    def exits(self) -> bool:
        """Whether the process is to end now that everything was published."""
        return self.finished and self._values['exit_when_done']

    def _header(self, stamp_s: float) -> Header:
        return Header(stamp=conversions.time_from_seconds(float(stamp_s)),
                      frame_id=self._frame_id)

    def _publish(self, index: int) -> None:
        frame = conversions.sendable(np.asarray(self._frames[index]))
        if self._as_image:
            message = conversions.image_from_frame(frame, self._header(self._pass_stamps[index]))
        else:
            message = conversions.multiarray_from_frame(frame)
        self._frame_publisher.publish(message)
        self._n_published += 1


def play(node: FramePublisherNode, executor: SingleThreadedExecutor, ending: Ending) -> None:
    """Publish until everything was published or a signal has come."""
    while not (ending.requested or node.exits):
        executor.spin_once(timeout_sec=min(node.step(), IDLE_S))
    end_s = time.monotonic() + LINGER_S
    while not ending.requested and time.monotonic() < end_s:
        executor.spin_once(timeout_sec=LINGER_S)
