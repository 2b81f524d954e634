"""How reliably, accurately and quickly the detector finds dim targets, and how rarely noise."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.engine.report import Quantity, SuiteResult
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.runs import checked_runs, run_seeds
from track_before_detect.evaluation.metrics.confidence import (
    bootstrap_interval,
    poisson_interval,
    wilson_interval,
)
from track_before_detect.evaluation.studies.detection.runs import (
    FOUND_PX,
    measure,
    NOISE,
    options_for,
    rmse_of,
    Run,
    TARGETS,
)
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.tracking.pipeline import TrackingPipeline

_TARGET_COLOUR, _NOISE_COLOUR = '#1f77b4', '#8c8c8c'


def run_detection(runs: int, seed: int, runner: Runner, **overrides: Any) -> SuiteResult:
    """Search simulated batches with known targets, and batches of noise.

    Parameters
    ----------
    runs : int
        Batches with targets; twice as many hold noise alone.
    seed : int
        Every batch gets a seed of its own from this one.
    runner : Runner
        Carries out the runs.
    **overrides
        Parameters of the scenarios to change.

    Returns
    -------
    SuiteResult
    """
    checked_runs(runs, seed)
    for_targets, for_noise = np.random.SeedSequence(seed).spawn(2)
    scenario = simulate(TARGETS, 0, **overrides).scenario
    if scenario.n_targets < 1:
        raise ParameterError(f'n_targets must be at least 1, got {scenario.n_targets}')
    options = options_for(scenario)
    threshold = TrackingPipeline(options).warm_up(
        (scenario.height, scenario.width), 1 / scenario.fps, scenario.n_frames, runner.progress)
    # Noise has the targets' frames, not their number.
    of_noise = {key: value for key, value in overrides.items() if key != 'n_targets'}

    def measured(name, sequence, count, changes, label):
        items = [{'scenario': name, 'seed': one, 'overrides': changes, 'threshold': threshold}
                 for one in run_seeds(sequence, count)]
        return [Run.read(result) for result in runner.map(measure, items, label)]

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
        [run.row() for run in with_targets + noise],
        _quantities(with_targets, noise, options.false_alarm_rate),
        {'runs': runs, 'seed': seed, 'found_px': FOUND_PX,
         'scenario': dataclasses.asdict(scenario), 'options': dataclasses.asdict(options)},
        lambda figure: _draw(figure, with_targets, noise))


def _quantities(with_targets, noise, requested):
    """Return the lines of the report."""
    n_targets = sum(run.n_targets for run in with_targets)
    n_found = sum(run.n_found for run in with_targets)
    n_false = sum(run.n_false for run in with_targets)
    n_alarms = sum(run.n_false > 0 for run in noise)
    n_runs = len(with_targets)
    found_runs = [run for run in with_targets if run.n_found]
    rmse = rmse_of(np.concatenate([run.distances.ravel() for run in with_targets]))
    rmse_ends = (float('nan'), float('nan'))
    if found_runs:
        sums = np.array([(np.nansum(run.distances**2), np.isfinite(run.distances).sum())
                         for run in found_runs])
        rmse_ends = bootstrap_interval(
            sums, lambda drawn: float(np.sqrt(drawn[:, 0].sum() / drawn[:, 1].sum())))
    quantities = [
        Quantity('targets found', n_found / n_targets, *wilson_interval(n_found, n_targets),
                 n_targets, 'targets', '%'),
        Quantity('false trajectories per batch with targets', n_false / n_runs,
                 *poisson_interval(n_false, n_runs), n_runs, 'batches'),
        Quantity('position RMSE of found targets', rmse, *rmse_ends, n_found, 'targets', 'px'),
        Quantity('noise batches with a trajectory', n_alarms / len(noise),
                 *wilson_interval(n_alarms, len(noise)), len(noise), 'batches', '%',
                 f'requested: {100 * requested:g} %'),
    ]
    for label, group, clock in (
            ('CPU time of a warm batch with targets, median', with_targets, 'cpu_s'),
            ('CPU time of a warm batch of noise, median', noise, 'cpu_s'),
            ('wall time of a warm batch with targets, median', with_targets, 'wall_s')):
        seconds = np.array([getattr(run, clock) for run in group])
        quantities.append(Quantity(
            label, float(np.median(seconds)),
            *bootstrap_interval(seconds, lambda drawn: float(np.median(drawn))), len(group),
            'batches', 's'))
    return quantities


def _draw(figure, with_targets, noise):
    """Draw the position errors, and the statistic of targets and noise."""
    errors, statistics = figure.subplots(1, 2)
    mean_errors = np.concatenate(
        [np.nanmean(run.distances, axis=1) for run in with_targets if run.n_found] or [[]])
    errors.hist(mean_errors, np.linspace(0, FOUND_PX, 31), color=_TARGET_COLOUR)
    errors.set_xlabel('mean position error of a found target [px]')
    errors.set_ylabel('targets')
    n_targets = sum(run.n_targets for run in with_targets)
    errors.set_title(f'{len(mean_errors)} of {n_targets} targets found')

    of_targets = np.concatenate([run.statistics for run in with_targets])
    of_noise = np.array([run.largest_statistic for run in noise])
    both = np.concatenate([of_targets, of_noise])
    bins = np.linspace(both.min(), both.max(), 41)
    statistics.hist(of_noise, bins, color=_NOISE_COLOUR, density=True, alpha=0.8,
                    label='largest in a batch of noise')
    if len(of_targets):
        statistics.hist(of_targets, bins, color=_TARGET_COLOUR, density=True, alpha=0.8,
                        label='found targets')
    threshold = noise[0].threshold
    statistics.axvline(threshold, color='black', linewidth=1.2,
                       label=f'threshold {threshold:.2f}')
    statistics.set_xlabel('statistic of a trajectory')
    statistics.set_ylabel('density')
    n_alarms = sum(run.n_false > 0 for run in noise)
    statistics.set_title(f'{n_alarms} of {len(noise)} batches of noise pass the threshold')
    statistics.legend()
    for axes in (errors, statistics):
        axes.spines[['top', 'right']].set_visible(False)
