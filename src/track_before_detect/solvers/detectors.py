"""The detectors by name."""

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchDetector
from track_before_detect.solvers.cancellation.mt_dp import MtDpDetector
from track_before_detect.solvers.cancellation.pc_dp import PcDpDetector
from track_before_detect.solvers.clutter.detector import ClutterDetector
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.either import EitherDetector
from track_before_detect.solvers.greedy import GreedyDetector
from track_before_detect.solvers.path_detector import PathDetector
from track_before_detect.solvers.ring.merit_detector import MeritDetector
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.solvers.tiled import TiledDetector
from track_before_detect.solvers.velocity.velocity_filter import VelocityFilterDetector

# By the names in options.DETECTORS.
DETECTOR_CLASSES: dict[str, type[BatchDetector]] = {
    'convex': ConvexDetector,
    'greedy': GreedyDetector,
    **dict.fromkeys(METHODS, MeritDetector),
    'mt_dp': MtDpDetector,
    'pc_dp': PcDpDetector,
    'velocity_filter': VelocityFilterDetector,
}


def make_detector(options: DetectorOptions,
                  part: tuple[int, int] = (0, 1)) -> BatchDetector:
    """Return a new detector, as the options say, of all tiles or of a part of them.

    ``part`` is as of :class:`TiledDetector`.
    """
    if options.calibration == 'clutter':
        return ClutterDetector(options)
    kind = DETECTOR_CLASSES[options.detector]
    detector = (EitherDetector(options, kind)
                if options.amplitude_model == 'either' and issubclass(kind, PathDetector)
                else kind(options))
    return detector if options.tile_px is None else TiledDetector(options, detector, part)
