"""How reliably, accurately and quickly the detector finds dim targets, and how rarely noise."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.engine.pictures import BLUE, GREY, tidy
from track_before_detect.evaluation.engine.quantities import estimate, Quantity, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import run_seeds
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.metrics.confidence import bootstrap_interval, poisson_interval
from track_before_detect.evaluation.studies.detection.runs import (
    FOUND_PX,
    measure,
    NOISE,
    options_for,
    rmse_of,
    TARGETS,
)
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.tracking.pipeline import TrackingPipeline

Runs = list[dict[str, Any]]


def run_detection(runs: int, seed: int, runner: Runner, **overrides: Any) -> SuiteResult:
    """Search simulated batches with known targets, and twice as many batches of noise.

    Parameters
    ----------
    runs, seed, runner, **overrides
        As of :meth:`Suite.run`, and parameters of the scenarios to change.
    """
    for_targets, for_noise = np.random.SeedSequence(seed).spawn(2)
    scenario = simulate(TARGETS, 0, **overrides).scenario
    if scenario.n_targets < 1:
        raise ParameterError(f'n_targets must be at least 1, got {scenario.n_targets}')
    options = options_for(scenario)
    threshold = TrackingPipeline(options).warm_up(
        (scenario.height, scenario.width), 1 / scenario.fps, scenario.n_frames, runner.progress)
    # Noise has the targets' frames, not their number.
    of_noise = {key: value for key, value in overrides.items() if key != 'n_targets'}

    def measured(name: str, sequence: np.random.SeedSequence, count: int,
                 changes: dict[str, Any], label: str) -> Runs:
        items = [{'scenario': name, 'seed': one, 'overrides': changes, 'threshold': threshold}
                 for one in run_seeds(sequence, count)]
        return runner.map(measure, items, label)

    with_targets = measured(TARGETS, for_targets, runs, overrides, 'searching three targets')
    noise = measured(NOISE, for_noise, 2 * runs, of_noise, 'searching noise')
    return SuiteResult(
        'Detection of three dim targets, and of nothing in noise',
        f'{runs} batches of {scenario.n_frames} frames of {scenario.width} x {scenario.height} '
        f'pixels with {scenario.n_targets} targets at SNR {scenario.snr:g} on straight lines, '
        f'at least {scenario.separation_px:g} px apart, up to {scenario.speed_px_per_frame:g} '
        f'px/frame, and {2 * runs} batches of noise alone. A target is found when a trajectory '
        f'stays within {FOUND_PX} px of it on average; each trajectory counts for one target at '
        'most, and every other trajectory is false. Intervals: Wilson for shares, Poisson for '
        'counts, bootstrap over runs for errors and times. CPU time is summed over all threads.',
        [{key: value for key, value in run.items() if key not in ('distances', 'statistics')}
         for run in with_targets + noise],
        _quantities(with_targets, noise, options.false_alarm_rate),
        {'found_px': FOUND_PX, 'scenario': dataclasses.asdict(scenario),
         'options': dataclasses.asdict(options)},
        lambda figure: _draw(figure, with_targets, noise))


def _quantities(with_targets: Runs, noise: Runs, requested: float) -> list[Quantity]:
    """Return the lines of the report."""
    n_targets = sum(run['n_targets'] for run in with_targets)
    n_found = sum(run['n_found'] for run in with_targets)
    n_false = sum(run['n_false'] for run in with_targets)
    n_runs = len(with_targets)
    sums = np.array([(np.nansum(distances**2), np.isfinite(distances).sum())
                     for distances in _distances(with_targets)])
    quantities = [
        share('targets found', n_found, n_targets, 'targets'),
        Quantity('false trajectories per batch with targets', n_false / n_runs,
                 *poisson_interval(n_false, n_runs), n_runs, 'batches'),
        Quantity('position RMSE of found targets',
                 rmse_of(np.concatenate([*map(np.ravel, _distances(with_targets)), []])),
                 *(bootstrap_interval(sums, _root_of_means) if len(sums) else (np.nan, np.nan)),
                 n_found, 'targets', 'px'),
        share('noise batches with a trajectory', _alarms(noise), len(noise), 'batches',
              f'requested: {100 * requested:g} %'),
    ]
    for label, group, clock in (
            ('CPU time of a warm batch with targets, median', with_targets, 'cpu_s'),
            ('CPU time of a warm batch of noise, median', noise, 'cpu_s'),
            ('wall time of a warm batch with targets, median', with_targets, 'wall_s')):
        quantities.append(estimate(
            label, [run[clock] for run in group],
            lambda drawn: float(np.median(drawn)), 'batches', 's'))
    return quantities


def _root_of_means(sums: NDArray) -> float:
    """Return the root of the mean square from sums of squares and their counts, (N, 2)."""
    return float(np.sqrt(sums[:, 0].sum() / sums[:, 1].sum()))


def _distances(runs: Runs) -> list[NDArray]:
    """Return the position errors of found targets, shape (K, T), of runs that found any."""
    return [np.array(run['distances'], float) for run in runs if run['n_found']]


def _alarms(noise: Runs) -> int:
    return sum(run['n_false'] > 0 for run in noise)


def _draw(figure: Any, with_targets: Runs, noise: Runs) -> None:
    """Draw the position errors, and the statistic of targets and noise."""
    errors, statistics = figure.subplots(1, 2)
    mean_errors = np.concatenate(
        [np.nanmean(distances, axis=1) for distances in _distances(with_targets)] or [[]])
    errors.hist(mean_errors, np.linspace(0, FOUND_PX, 31), color=BLUE)
    errors.set(xlabel='mean position error of a found target [px]', ylabel='targets')
    n_targets = sum(run['n_targets'] for run in with_targets)
    errors.set_title(f'{len(mean_errors)} of {n_targets} targets found')

    of_targets = np.concatenate([run['statistics'] for run in with_targets])
    of_noise = np.array([run['largest_statistic'] for run in noise])
    both = np.concatenate([of_targets, of_noise])
    bins = np.linspace(both.min(), both.max(), 41)
    statistics.hist(of_noise, bins, color=GREY, density=True, alpha=0.8,
                    label='largest in a batch of noise')
    if len(of_targets):
        statistics.hist(of_targets, bins, color=BLUE, density=True, alpha=0.8,
                        label='found targets')
    threshold = noise[0]['threshold']
    statistics.axvline(threshold, color='black', linewidth=1.2,
                       label=f'threshold {threshold:.2f}')
    statistics.set(xlabel='statistic of a trajectory', ylabel='density',
                   title=f'{_alarms(noise)} of {len(noise)} batches of noise pass the threshold')
    statistics.legend()
    tidy((errors, statistics), grid=False)


SUITE = Suite(
    'The convex detector on three targets at SNR 3 (N runs) and on noise alone (2 N runs): '
    'targets found, false trajectories, accuracy, time, realised false alarm rate.',
    run_detection)
