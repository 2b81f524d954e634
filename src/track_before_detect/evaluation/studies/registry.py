"""The suites of ``tbd evaluate`` by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from track_before_detect.errors import ParameterError, suggestion
from track_before_detect.evaluation.engine.report import SuiteResult
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.compare.suite import run_compare
from track_before_detect.evaluation.studies.detection.suite import run_detection
from track_before_detect.evaluation.studies.limits.suites import (
    run_accuracy,
    run_dim,
    run_false_alarms,
)
from track_before_detect.evaluation.studies.parallel.suite import run_parallel
from track_before_detect.evaluation.studies.patent.suite import run_patent
from track_before_detect.evaluation.studies.range_doppler.suite import run_range_doppler
from track_before_detect.evaluation.studies.ring.suites import run_ring_multi, run_ring_single


@dataclass(frozen=True)
class Suite:
    """A study that can be repeated.

    Attributes
    ----------
    description : str
        What it finds out.
    run : callable
        Told the number of runs, the seed and a Runner, returns a SuiteResult.
    """

    description: str
    run: Callable[[int, int, Runner], SuiteResult]


SUITES: dict[str, Suite] = {
    'detection': Suite(
        'The convex detector on three targets at SNR 3 (N runs) and on noise alone (2 N runs): '
        'targets found, false trajectories, accuracy, time, realised false alarm rate.',
        run_detection),
    'patent': Suite(
        'Figures 2-7 of US application 18/790,866 (N scenes each) by the convex method, its '
        'continuation, t = 0 only and greedy: how often each shows what the text describes.',
        run_patent),
    'compare': Suite(
        'Every detector on eight scenes at SNR 1.5 to 3 (N batches each) at equal false alarms: '
        'the best per scene, targets found, false trajectories, GOSPA.', run_compare),
    'dim': Suite(
        'Dim targets on lines and arcs (N each), SNR 1.5 and 2, by the convex detector and by an '
        'exhaustive search over straight lines with the same statistic at the same false alarms.',
        run_dim),
    'accuracy': Suite(
        'Isolated targets at SNR 5 to 50 (N each): position error over the Cramér-Rao bound, '
        'amplitude, second trajectories.', run_accuracy),
    'false-alarms': Suite(
        'Batches of noise of 64, 128 and 256 px (20 N, 8 N and 2 N): how many hold a trajectory '
        'beside the rate that was asked for.', run_false_alarms),
    'ring-single': Suite(
        'Single targets by the six methods of Fu et al. 2022: Figure 6 and Table 1 (N runs a '
        'point, 54 points).', run_ring_single),
    'ring-multi': Suite(
        'Two and three targets by the six methods of Fu et al. 2022: Figures 9 and 10 and Table '
        '2 (N runs a point, 12 points).', run_ring_multi),
    'parallel': Suite(
        'The six targets of Guo et al. 2018 by mt_dp and pc_dp, 4 to 15 dB: Figures 9 and 10, and '
        'the cost ratio of Eq. 18 (N runs a point, 12 points).', run_parallel),
    'range-doppler': Suite(
        'Range-Doppler maps in complex noise (N scenes, 4 N batches of noise): the SNR at which a '
        'target is found with the coupling of range and Doppler, and without it.',
        run_range_doppler),
}


def suite_named(name: str) -> Suite:
    """Return a suite, or say which there are."""
    if name not in SUITES:
        raise ParameterError(f'unknown suite {name!r}; {suggestion(name, SUITES)}')
    return SUITES[name]
