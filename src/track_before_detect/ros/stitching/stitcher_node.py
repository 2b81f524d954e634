"""Node ``stitcher``: trajectories of several detectors in, each with a region of one stream.

In: ``NAME/trajectories/points`` of each of the parameter ``inputs``; out: ``trajectories/points``,
``trajectories/path``, ``trajectories/markers`` with what was found twice left out and ids that are
kept across seams, and ``/diagnostics``.
"""

from collections.abc import Mapping, Sequence, Set
from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.ros import conversions
from track_before_detect.ros.detector_node import LIFETIME_BATCHES, OUTPUT_DEPTH
from track_before_detect.ros.diagnostics import status_message, Warnings
from track_before_detect.ros.logs.qos_events import input_events
from track_before_detect.ros.parameters import (
    check_topic_name,
    NodeParameter,
    ParameterizedNode,
)
from track_before_detect.ros.stitching.merging import check_sightings, RegionStitcher
from track_before_detect.ros.stitching.rounds import RegionBatch, Rounds
from track_before_detect.types import Trajectory

POINTS = 'trajectories/points'
INPUT_DEPTH = 100
LOOK_PERIOD_S = 0.1
DIAGNOSTICS_PERIOD_S = 1.0

PARAMETERS = [
    NodeParameter(
        'inputs', [], 'Namespaces of the detectors, two at least; of each, its '
        'trajectories/points are merged.', 'texts'),
    NodeParameter(
        'wait_s', 2.0, 'Longest time that a batch of one detector waits for those of the others; '
        'one that was silent all the while is not waited for again until it is heard.', 'number',
        unit='s', above=0.0),
    NodeParameter(
        'psf_sigma_px', 1.0, 'Standard deviation of the point spread function that the detectors '
        'search with: three of it, at least 3 px, apart is one target.', 'number', unit='px',
        above=0.0),
]


class StitcherNode(ParameterizedNode):
    """Merges what the detectors of several regions publish of each batch.

    Parameters
    ----------
    name, **settings
        As of :class:`ParameterizedNode`.
    """

    def __init__(self, name: str = 'stitcher', **settings: Any) -> None:
        super().__init__(name, PARAMETERS, **settings)
        values = self.values()
        self._names: list[str] = values['inputs']
        self._rounds = Rounds(len(self._names), values['wait_s'])
        self._stitcher = RegionStitcher(values['psf_sigma_px'])
        self._warnings = Warnings(self.get_logger().warning)
        self._warn = self._warnings.add
        self._n_received = [0] * len(self._names)
        self._n_rounds = self._n_incomplete = self._n_twice = self._n_trajectories = 0
        self._n_restarts = self._n_refused = self._n_lost = 0
        # The round in which a trajectory was shown last.
        self._shown: dict[int, int] = {}
        self.finish_parameters()
        self._points = self.create_publisher(PointCloud2, POINTS, OUTPUT_DEPTH)
        self._paths = self.create_publisher(Path, 'trajectories/path', OUTPUT_DEPTH)
        self._markers = self.create_publisher(MarkerArray, 'trajectories/markers', OUTPUT_DEPTH)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', OUTPUT_DEPTH)
        for region, name in enumerate(self._names):
            topic = f'{name}/{POINTS}'
            self.create_subscription(
                PointCloud2, topic, partial(self._take, region), INPUT_DEPTH,
                event_callbacks=input_events(partial(self._lost, topic),
                                             partial(self._unheard, topic)))
        # A simulated clock may stand still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK_PERIOD_S, self._merge, clock=steady)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=steady)

    def check_values(self, values: Mapping[str, Any], told: Set[str]) -> None:
        """Raise ParameterError where ``inputs`` are not so many different names."""
        names = values['inputs']
        if len(set(names)) < 2 or len(set(names)) < len(names):
            raise ParameterError('inputs must be the namespaces of two detectors at least, each '
                                 f'once, got {names}')
        for name in names:
            check_topic_name(f'{name}/{POINTS}', 'inputs must be names of namespaces', name)

    def _take(self, region: int, message: PointCloud2) -> None:
        self._n_received[region] += 1
        try:
            found = conversions.trajectories_from_points(message)
            check_sightings(found)
        except DataError as error:
            self._n_refused += 1
            self._warn('message', f'message of {self._names[region]} refused: {error}')
            return
        if self._rounds.put(region, conversions.seconds_from_time(message.header.stamp),
                            (message.header, found), time.monotonic()):
            self._n_restarts += 1
            self._stitcher.reset()
        self._merge()

    def _merge(self) -> None:
        for batches in self._rounds.take(time.monotonic()):
            self._n_rounds += 1
            self._n_incomplete += len(batches) < len(self._names)
            self._publish(list(batches.values()))

    def _publish(self, batches: Sequence[RegionBatch]) -> None:
        newest = max(batches, key=lambda batch: batch.stamp_s)
        header: Header = newest.content[0]
        parts: list[list[Trajectory]] = [batch.content[1] for batch in batches]
        merged = self._stitcher.merge(parts)
        self._n_trajectories += len(merged)
        self._n_twice += sum(map(len, parts)) - len(merged)
        self._shown |= {one.id: self._n_rounds for one in merged}
        # A trajectory may be of a region that is in the next round only.
        n_patient = 1 if len(batches) == len(self._names) else len(self._names)
        ended = {one for one, newest in self._shown.items()
                 if newest <= self._n_rounds - n_patient}
        self._shown = {one: newest for one, newest in self._shown.items() if one not in ended}
        self._points.publish(conversions.points_from_trajectories(merged, header))
        for path in conversions.paths_from_trajectories(merged, header):
            self._paths.publish(path)
        self._markers.publish(conversions.markers_from_trajectories(
            merged, header, LIFETIME_BATCHES * (newest.hop_s or 1.0), sorted(ended)))

    def _lost(self, topic: str, n_more: int, n_all: int) -> None:
        self._n_lost += n_more
        self._warn(f'lost {topic}', f'{n_all} messages on {topic!r} were lost')

    def _unheard(self, topic: str, _: int, policy: str) -> None:
        self._warn(f'qos {topic}', f'a publisher on {topic!r} offers a quality of service '
                   f'({policy}) that this node cannot take, so nothing is received from it')

    def _publish_diagnostics(self) -> None:
        silent = [self._names[region] for region in sorted(self._rounds.silent)]
        for name in silent:
            self._warn(f'silent {name}', f'nothing came from {name} for '
                       f'{self.values()["wait_s"]:g} s: what the others find is told without it')
        self._diagnostics.publish(status_message(
            self.get_fully_qualified_name().lstrip('/'), self.get_clock().now().to_msg(),
            f'merging {", ".join(self._names)}', {
                'batches': self._n_rounds,
                'batches_incomplete': self._n_incomplete,
                'trajectories': self._n_trajectories,
                'found_twice': self._n_twice,
                'restarts': self._n_restarts,
                'messages_refused': self._n_refused,
                'messages_lost': self._n_lost,
                'silent': ' '.join(silent),
                'last_warning': self._warnings.last,
                **{f'{name}.{key}': count for key, counts in (
                    ('batches_received', self._n_received), ('batches_late', self._rounds.n_late))
                    for name, count in zip(self._names, counts, strict=True)},
            }, self._warnings))
