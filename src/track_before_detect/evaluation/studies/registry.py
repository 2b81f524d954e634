"""The suites of ``tbd evaluate`` by name."""

from track_before_detect.errors import named
from track_before_detect.evaluation.engine.suite import Suite
from track_before_detect.evaluation.studies.accuracy import suite as accuracy
from track_before_detect.evaluation.studies.compare import suite as compare
from track_before_detect.evaluation.studies.detection import suite as detection
from track_before_detect.evaluation.studies.dim import suite as dim
from track_before_detect.evaluation.studies.false_alarms import modelled
from track_before_detect.evaluation.studies.false_alarms import suite as false_alarms
from track_before_detect.evaluation.studies.false_paths import suite as false_paths
from track_before_detect.evaluation.studies.parallel import suite as parallel
from track_before_detect.evaluation.studies.patent import suite as patent
from track_before_detect.evaluation.studies.range_doppler import suite as range_doppler
from track_before_detect.evaluation.studies.real import alarms as real_alarms
from track_before_detect.evaluation.studies.real import suite as real
from track_before_detect.evaluation.studies.ring import multi as ring_multi
from track_before_detect.evaluation.studies.ring import single as ring_single

SUITES: dict[str, Suite] = {
    'detection': detection.SUITE,
    'patent': patent.SUITE,
    'compare': compare.SUITE,
    'dim': dim.SUITE,
    'accuracy': accuracy.SUITE,
    'false-alarms': false_alarms.SUITE,
    'modelled-alarms': modelled.SUITE,
    'false-paths': false_paths.SUITE,
    'ring-single': ring_single.SUITE,
    'ring-multi': ring_multi.SUITE,
    'parallel': parallel.SUITE,
    'range-doppler': range_doppler.SUITE,
    'real': real.SUITE,
    'real-alarms': real_alarms.SUITE,
}


def suite_named(name: str) -> Suite:
    """Return a suite, or say which there are."""
    return named('suite', name, SUITES)
