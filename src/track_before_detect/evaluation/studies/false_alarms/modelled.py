"""Thresholds of the model of noise, for options that it was not fitted to."""

from collections.abc import Iterator
import functools
from typing import Any

from track_before_detect.evaluation.engine.detectors import detector_of, stamps_of
from track_before_detect.evaluation.engine.quantities import share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.studies.false_alarms.runs import noise_alarms
from track_before_detect.evaluation.studies.false_alarms.suite import draw_rates
from track_before_detect.evaluation.studies.false_paths.design import (
    KINDS,
    option_sets,
    side_px,
)
from track_before_detect.solvers.calibration.threshold import level_passed

# Rates asked for, and the factor within which they should come.
RATES = {0.5: 1.25, 0.05: 1.25, 0.005: 1.5}
# Kinds that take turns.
GROUPS = (KINDS[:2], KINDS[2:5], KINDS[5:])
# Options that are tried for each of these, by the seed of their design, until so many are within
# the model.
SEED, N_SETS, MOST_TRIED = 23, 24, 128
# CPU time of one search, by formula, beyond which options are left out.
MOST_SECONDS = 0.1


def run_modelled(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Count batches of noise with a trajectory, ``runs`` for each set of options."""
    rows = []
    for number, (kind, n_frames, side, options, thresholds) in enumerate(_modelled_sets()):
        results = runner.map(noise_alarms, items_of(
            seed, f'modelled {number}', runs, side_px=side, n_frames=n_frames, options=options,
            thresholds=thresholds), f'searching noise, {number + 1} of {len(GROUPS) * N_SETS}')
        rows += [{'set': number, 'kind': kind, 'n_frames': n_frames, 'side_px': side, **{
            name: options.get(name, '') for name in (
                'psf_sigma_px', 'max_speed_px_s', 'max_acceleration_px_s2', 'motion_model')},
            'requested': rate, 'threshold': threshold, 'batches': runs,
            'alarms': sum(result['alarms'][place] for result in results)}
            for place, (rate, threshold) in enumerate(zip(RATES, thresholds, strict=True))]
    quantities = [
        share(f'{kind.name}, all, {100 * rate:g} % requested', sum(row['alarms'] for row in group),
              sum(row['batches'] for row in group), 'batches', _goal(rate))
        for kinds in GROUPS for kind in kinds for rate in RATES
        if (group := [row for row in rows if (row['kind'], row['requested'])
                      == (kind.name, rate)])]
    quantities += [share(
        f'{row["set"]}: {row["kind"]}, {row["n_frames"]} frames of {row["side_px"]} '
        f'px, PSF {row["psf_sigma_px"]} px, speed {row["max_speed_px_s"] or 0} px/s, '
        f'{100 * row["requested"]:g} % requested', row['alarms'], row['batches'], 'batches',
        _goal(row['requested'])) for row in rows]
    return SuiteResult(
        'False alarms with thresholds of the model of noise',
        'Batches of white noise, convex detector: the share with a trajectory, beside the '
        'false_alarm_rate that the model gave a threshold for. Sets of options that the model '
        'was not fitted to, of the same kind (Sobol points). Intervals: Wilson.',
        rows, quantities, {}, functools.partial(draw_rates, rows=[
            {**row, 'label': row['kind']} for row in rows], factor=1.25))


def _modelled_sets() -> Iterator[tuple[str, int, int, dict[str, Any], list[float]]]:
    """Yield kind, frames, side, options and thresholds of the first sets that the model knows."""
    for kinds in GROUPS:
        found = 0
        for n_frames, options in option_sets(MOST_TRIED, SEED):
            side, kind = side_px(n_frames, options), kinds[found % len(kinds)]
            told = {**options, **kind.options}
            study = detector_of(told).noise_study(stamps_of(n_frames), (side, side))
            if study.false_paths is None or study.seconds((side, side)) > MOST_SECONDS:
                continue
            yield kind.name, n_frames, side, told, [
                level_passed(study.false_paths, rate) for rate in RATES]
            found += 1
            if found == N_SETS:
                break


def _goal(rate: float) -> str:
    return f'goal: {100 * rate / RATES[rate]:.3g} to {100 * rate * RATES[rate]:.3g} %'


SUITE = Suite(
    'N batches of noise with each of 72 sets of options that the model of noise was not fitted '
    'to: how many hold a trajectory beside the rate that was asked for.', run_modelled, runs=400)
