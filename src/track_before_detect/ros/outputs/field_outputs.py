"""Topics of message packages that need not be installed; made only where somebody listens."""

from collections.abc import Callable, Iterator, Mapping
import importlib
import logging
from types import ModuleType
from typing import Any
from uuid import uuid4

from rclpy.publisher import Publisher
from std_msgs.msg import Header

from track_before_detect.options import DetectorOptions
from track_before_detect.ros.outputs.field_messages import (
    detections_2d,
    image_annotations,
    radar_tracks,
)
from track_before_detect.ros.outputs.seen_targets import RadarScale, SeenTarget, targets_in
from track_before_detect.ros.parameters import NodeParameter
from track_before_detect.ros.search_results import StreamResult

_LOG = logging.getLogger(__name__)

# Side of the box around a target, in standard deviations of the PSF.
BOX_SIGMAS = 6.0

SCALE_PARAMETERS = [
    NodeParameter(
        'range_m_per_row', 0.0, 'Of radar maps: range from one row to the next; with the scale of '
        'the columns tracks are published in metres where radar_msgs is installed. 0 is none.',
        'number', unit='m'),
    NodeParameter('range_of_first_row_m', 0.0, 'Of radar maps: range of row 0.', 'number',
                  unit='m'),
    NodeParameter(
        'bearing_rad_per_column', 0.0, 'Of radar maps: bearing from one column to the next, '
        'anticlockwise; negative where columns go clockwise. 0 where columns are Doppler.',
        'number', unit='rad'),
    NodeParameter(
        'bearing_of_first_column_rad', 0.0, 'Of radar maps: bearing of column 0, anticlockwise '
        'from straight ahead.', 'number', unit='rad'),
    NodeParameter(
        'doppler_m_s_per_column', 0.0, 'Of radar maps: speed from one column to the next, '
        'positive where receding; doppler_offset_bins says where it is zero. 0 where columns are '
        'bearing.', 'number', unit='m/s'),
]

# From the module of the messages, the targets and header of a frame, its number of columns and the
# options of the search.
Made = Callable[[ModuleType, list[SeenTarget], Header, int, DetectorOptions], object]


class FieldOutputs:
    """Publishers of the message packages that are installed.

    Parameters
    ----------
    create : callable
        Returns a publisher of a kind of message on a topic.
    values : mapping
        Parameters of the node, see :data:`SCALE_PARAMETERS`.
    """

    def __init__(self, create: Callable[[type, str], Publisher], values: Mapping[str, Any]):
        scale = RadarScale.of(values)
        self.reset()
        self._outputs: list[tuple[Publisher, ModuleType, Made]] = []

        def output(topic: str, package: str, kind: str, made: Made) -> None:
            try:
                messages = importlib.import_module(f'{package}.msg')
            except ImportError:
                _LOG.debug('%s is not installed: no topic %s', package, topic)
                return
            publisher = create(getattr(messages, kind), topic)
            self._outputs.append((publisher, messages, made))

        output('trajectories/detections', 'vision_msgs', 'Detection2DArray',
               lambda messages, targets, header, _, options: detections_2d(
                   messages, targets, header, BOX_SIGMAS * options.psf_sigma_px))
        output('trajectories/annotations', 'foxglove_msgs', 'ImageAnnotations',
               lambda messages, targets, header, _, options: image_annotations(
                   messages, targets, header, BOX_SIGMAS * options.psf_sigma_px))
        if scale is not None:
            output('trajectories/radar_tracks', 'radar_msgs', 'RadarTracks',
                   lambda messages, targets, header, n_columns, options: radar_tracks(
                       messages, targets, header, scale,
                       n_columns // 2 + options.doppler_offset_bins,
                       n_columns if options.doppler_ambiguities else 0, self._stream))

    def reset(self) -> None:
        """Forget which frames and targets were seen: their numbers begin again."""
        self._newest = -1
        self._stream = uuid4()

    def messages(self, result: StreamResult, options: DetectorOptions,
                 ) -> Iterator[tuple[Publisher, object]]:
        """Yield what is to be published of a batch, one message for each frame not seen before."""
        heard = [output for output in self._outputs if output[0].get_subscription_count()]
        numbers = [int(index) for index in result.batch.frame_indices if index > self._newest]
        self._newest = max([self._newest, *numbers])
        n_columns = result.batch.frames.shape[2]
        for index in numbers if heard else ():
            targets = targets_in(result.detection.trajectories, index)
            for publisher, messages, made in heard:
                yield publisher, made(messages, targets, result.tags[index], n_columns, options)
