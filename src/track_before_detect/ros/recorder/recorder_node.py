"""Node ``recorder``: writes frames and results to an MCAP file that survives a crash.

In: the topics of the parameter ``topics``, of whatever type they are; out: ``/diagnostics``.
"""

from datetime import datetime
from pathlib import Path
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

from track_before_detect.errors import MissingExtraError, ParameterError
from track_before_detect.ros.diagnostics import status_message, Warnings
from track_before_detect.ros.logs.qos_events import input_events
from track_before_detect.ros.parameters import (
    check_topic_name,
    NodeParameter,
    ParameterizedNode,
)
from track_before_detect.ros.recorder.definitions import definition, message_class

INPUT_DEPTH, OUTPUT_DEPTH = 100, 50
LOOK_PERIOD_S = 0.2
DIAGNOSTICS_PERIOD_S = 1.0
SUFFIX = '.mcap'

TOPICS = (
    'image', 'image/compressed', 'frame', 'truth/path',
    *(f'trajectories/{name}' for name in (
        'path', 'points', 'markers', 'detections', 'annotations', 'radar_tracks')),
    '/diagnostics')

PARAMETERS = [
    NodeParameter(
        'output', '', 'File to write, which ends with .mcap and does not exist; empty takes '
        'recording_DATE_TIME.mcap in the working folder.', 'text'),
    NodeParameter(
        'topics', ' '.join(TOPICS), 'Topics to record, with spaces between them; each as soon as '
        'somebody publishes it.', 'text'),
    NodeParameter(
        'compression', 'none', 'Of the file; noise does not get much smaller.', 'text',
        choices=('none', 'lz4', 'zstd')),
    NodeParameter(
        'commit_period_s', 0.5, 'How often what was received is brought into the file; what is '
        'more recent is lost when the process is killed.', 'number', unit='s', minimum=0.05,
        maximum=60.0),
    NodeParameter(
        'max_held_mb', 64, 'What is held at most, for that long or while the disk is full; of '
        'more, messages are left out and counted.', 'integer', unit='MB', minimum=1,
        maximum=2000),
]


class RecorderNode(ParameterizedNode):
    """Subscribes to topics when they appear, and commits what it received again and again.

    Parameters
    ----------
    name : str
        Name of the node.
    **settings
        Of :class:`rclpy.node.Node`: context, namespace, parameter_overrides and so on.
    """

    def __init__(self, name: str = 'recorder', **settings: Any) -> None:
        super().__init__(name, PARAMETERS, **settings)
        values = self.values()
        # In the order of their names, however often one is named.
        self._missing = sorted({self._full_name(topic) for topic in values['topics'].split()})
        if not self._missing:
            raise ParameterError('topics must name a topic at least')
        self._warnings = Warnings(self.get_logger().warning)
        self._warn = self._warnings.add
        self._counts: dict[str, int] = {}
        self._n_left_out = self._n_lost = 0
        self._trouble = ''
        # To the millisecond: another may be started in the same second.
        self._path = Path(values['output'] or datetime.now().strftime(
            'recording_%Y%m%d_%H%M%S_%f')[:-3] + SUFFIX)
        # Before the file is made, which is left behind otherwise.
        self.finish_parameters()
        self._open(values)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', OUTPUT_DEPTH)
        # A simulated clock may stand still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for period_s, act in ((LOOK_PERIOD_S, self._look_around),
                              (values['commit_period_s'], self._commit),
                              (DIAGNOSTICS_PERIOD_S, self._publish_diagnostics)):
            self.create_timer(period_s, act, clock=steady)
        self.get_logger().info(f'recording to {self._path}')

    def destroy_node(self) -> None:
        """Finish the file, then destroy the node."""
        try:
            self._file.close()
        except OSError as error:
            self.get_logger().error(
                f'{self._path} is left without index and without what was held: {error}')
        n_messages = sum(self._counts.values())
        self.get_logger().info(f'done: {n_messages} messages of {len(self._counts)} topics in '
                               f'{self._path}, {self._n_left_out} left out')
        super().destroy_node()

    def _full_name(self, topic: str) -> str:
        check_topic_name(topic, 'topics must be names of topics')
        return self.resolve_topic_name(topic)

    def _open(self, values: dict[str, Any]) -> None:
        try:
            from track_before_detect.ros.recorder.bag_file import BagFile
        except ImportError as error:
            raise MissingExtraError(
                "recording needs mcap: pip install 'track_before_detect[recorder]'") from error
        if self._path.suffix != SUFFIX:
            raise ParameterError(f'output must end with {SUFFIX}, got {self._path}')
        try:
            self._file = BagFile(
                self._path, values['compression'], values['max_held_mb'] * 10**6)
        except OSError as error:
            raise ParameterError(f'output {self._path} cannot be made: {error.strerror}'
                                 ) from error

    def _look_around(self) -> None:
        """Subscribe to what is published by now."""
        for topic in list(self._missing):
            publishers = self.get_publishers_info_by_topic(topic)
            if publishers:
                self._missing.remove(topic)
                self._subscribe(topic, publishers[0].topic_type,
                                [publisher.qos_profile for publisher in publishers])

    def _subscribe(self, topic: str, kind: str, offered: list[QoSProfile]) -> None:
        """Record a topic, asking for no more than all of its publishers offer."""
        try:
            message, text = message_class(kind), definition(kind)
        except ImportError as error:
            self._warn(topic, f'{topic} is not recorded: {error}')
            return
        reliable = all(qos.reliability == QoSReliabilityPolicy.RELIABLE for qos in offered)
        kept = all(qos.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
        self._file.add_topic(topic, kind, text)
        self._counts[topic] = 0

        # A function of two parameters, by which rclpy sees that the stamps are wanted.
        def take(data: bytes, info: dict[str, int]) -> None:
            self._take(topic, data, info)

        def lost(n_more: int, n_all: int) -> None:
            self._n_lost += n_more
            self._warn(f'lost {topic}', f'{n_all} messages of {topic} were lost')

        def unheard(_: int, policy: str) -> None:
            self._warn(f'qos {topic}', f'a publisher of {topic} that came later offers less '
                       f'({policy}) than those before, so nothing of it is recorded')

        self.create_subscription(
            message, topic, cast(Any, take), QoSProfile(
                depth=INPUT_DEPTH,
                reliability=QoSReliabilityPolicy.RELIABLE if reliable
                else QoSReliabilityPolicy.BEST_EFFORT,
                durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if kept
                else QoSDurabilityPolicy.VOLATILE),
            event_callbacks=input_events(lost, unheard), raw=True)
        self.get_logger().info(f'recording {topic} ({kind})')

    def _take(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        received_ns = self.get_clock().now().nanoseconds
        if not received_ns:
            self._n_left_out += 1
            self._warn('clock', f'{self._n_left_out} messages left out: use_sim_time is set, but '
                       'no time came on /clock')
        elif self._file.write(topic, data, received_ns, info['source_timestamp']):
            self._counts[topic] += 1
        else:
            self._n_left_out += 1
            self._warn('held', f'{self._n_left_out} messages left out: max_held_mb '
                       f'({self.values()["max_held_mb"]}) waits to be written already')

    def _commit(self) -> None:
        try:
            self._file.commit()
        except OSError as error:
            self._trouble = f'{self._path} cannot be written: {error.strerror}'
            self._warn('disk', f'{self._trouble}; what comes is held, and tried again')
            return
        if self._trouble:
            self._trouble = ''
            self.get_logger().info(f'{self._path} can be written again')

    def _publish_diagnostics(self) -> None:
        self._diagnostics.publish(status_message(
            self.get_fully_qualified_name().lstrip('/'), self.get_clock().now().to_msg(),
            f'recording to {self._path}', {
                'output': self._path,
                'bytes_safe': self._file.n_bytes,
                'messages': sum(self._counts.values()),
                'messages_left_out': self._n_left_out,
                'messages_lost': self._n_lost,
                **{f'messages of {topic}': count for topic, count in self._counts.items()},
                'topics_without_publisher': ' '.join(self._missing),
            }, self._warnings, self._trouble))
