"""Dim targets, by the convex detector and by an exhaustive search over straight lines."""

from collections.abc import Mapping, Sequence
import functools
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.pictures import BLUE, legend_above, RED, tidy
from track_before_detect.evaluation.engine.quantities import estimate, mean, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.metrics.confidence import wilson_interval
from track_before_detect.evaluation.studies.dim import runs as dim_runs
from track_before_detect.evaluation.studies.dim.runs import FOUND_PX, MODELS, SIDE_PX
from track_before_detect.evaluation.studies.single_target import N_FRAMES, RADIUS_PX, RATE

SNRS = (1.5, 2.0)
MOTIONS = ('line', 'arc')
# What is asked of the detector on arcs at SNR 1.5 and on both motions at SNR 2.
_GOALS = {('arc', 1.5, 'constant'): 0.75, ('arc', 1.5, 'fluctuating'): 0.58,
          ('line', 2.0, 'constant'): 0.99, ('line', 2.0, 'fluctuating'): 0.97,
          ('arc', 2.0, 'constant'): 0.99, ('arc', 2.0, 'fluctuating'): 0.97}
# Of the largest statistics of the exhaustive search, the share its tail is fitted to.
_TAIL = 0.25
# Batches of noise searched exhaustively for each target of a line
# (docs/constants/evaluation.md).
NOISE_PER_RUN = 4
_COLOURS = {'constant': BLUE, 'fluctuating': RED}


def run_dim(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Look for dim targets with the detector and exhaustively."""
    thresholds = {model: runner.threshold(
        {'amplitude_model': model, 'false_alarm_rate': RATE},
        (N_FRAMES, SIDE_PX, SIDE_PX)) for model in MODELS}
    noise = runner.map(dim_runs.dim_noise, items_of(seed, 'dim noise', NOISE_PER_RUN * runs),
                       'searching noise exhaustively')
    maxima = {model: np.array([result[model] for result in noise]) for model in MODELS}
    bounds = {model: _passed_by_rate(maxima[model]) for model in MODELS}
    cases = list(itertools.product(MOTIONS, SNRS))
    items = [item for motion, snr in cases for item in items_of(
        seed, f'dim {motion} {snr:g}', runs, motion=motion, snr=snr, thresholds=thresholds)]
    results = runner.map(dim_runs.dim_target, items, 'searching for dim targets')
    rows = []
    for item, result in zip(items, results, strict=True):
        row = {key: item[key] for key in ('motion', 'snr', 'seed')}
        for model in MODELS:
            nearby = result['nearby'][model]
            row[f'found_{model}'] = result['found'][model]
            row[f'exhaustive_{model}'] = nearby is not None and nearby > bounds[model]
        rows.append(row)
    quantities = []
    for case, model in itertools.product(cases, MODELS):
        ours, theirs = (_flags(rows, case, kind, model) for kind in ('found', 'exhaustive'))
        name, goal = f'{case[0]}, SNR {case[1]:g}, {model}', _GOALS.get((*case, model))
        quantities += [
            share(f'{name}: found', ours.sum(), len(ours), 'targets',
                  '' if goal is None else f'goal: {100 * goal:g} %'),
            share(f'{name}: exhaustive search', theirs.sum(), len(theirs), 'targets'),
            mean(f'{name}: found less exhaustive', ours.astype(float) - theirs, 'targets', '%',
                 'goal: at least -3 %' if goal is None else '')]
    quantities += [
        estimate(f'threshold of the exhaustive search, {model}', maxima[model], _passed_by_rate,
                 'batches of noise', note=f'of the detector: {thresholds[model]:.2f}')
        for model in MODELS]
    return SuiteResult(
        'Dim targets beside an exhaustive search',
        f'{runs} batches of {N_FRAMES} frames of {SIDE_PX} x {SIDE_PX} pixels per line, PSF of '
        '1 px, one target of constant amplitude at a random heading and a speed of 0.2 to 1 '
        f'px/frame, on lines and on arcs of {RADIUS_PX:g} px radius. The convex '
        f'detector with default options, {100 * RATE:g} % false alarms, with the amplitude model '
        'constant and fluctuating; found means a trajectory less than '
        f'{FOUND_PX:g} px from the target on average. Beside it an exhaustive search '
        'over straight lines with the same statistic on the same frames, every half pixel and '
        'every velocity up to 1 px/frame, with a threshold from the largest statistics of '
        f'{len(noise)} batches of noise, at the same rate; on lines it is the bound, on arcs it '
        'is not. Intervals: Wilson; bootstrap for thresholds and for differences on the same '
        'frames.',
        rows, quantities, {'false_alarm_rate': RATE, 'thresholds': thresholds},
        functools.partial(_draw, rows=rows, cases=cases))


def _flags(rows: Sequence[Mapping[str, Any]], case: tuple[str, float], kind: str,
           model: str) -> NDArray[np.bool_]:
    """Return for each target of a motion and SNR whether it was found."""
    return np.array([row[f'{kind}_{model}'] for row in rows
                     if (row['motion'], row['snr']) == case])


def _passed_by_rate(maxima: NDArray) -> float:
    """Return what a share RATE passes; squares of the largest have an exponential tail."""
    ordered = np.sort(maxima**2)
    start = float(np.quantile(ordered, 1 - _TAIL))
    scale = float(np.mean(ordered[ordered >= start])) - start
    return float(np.sqrt(start + scale * np.log(_TAIL / RATE)))


def _draw(figure: Any, rows: Sequence[Mapping[str, Any]],
          cases: Sequence[tuple[str, float]]) -> None:
    axes = figure.subplots()
    places = np.arange(len(cases))
    for number, (model, (kind, label)) in enumerate(itertools.product(
            MODELS, (('exhaustive', 'exhaustive straight lines'), ('found', 'convex detector')))):
        flags = [_flags(rows, case, kind, model) for case in cases]
        shares = np.array([np.mean(one) for one in flags])
        ends = np.array([wilson_interval(one.sum(), len(one)) for one in flags])
        at = places + 0.2 * (number - 1.5)
        axes.bar(at, 100 * shares, 0.18, label=f'{label}, {model}', color=_COLOURS[model],
                 alpha=0.45 if kind == 'exhaustive' else 1.0)
        axes.errorbar(at, 100 * shares, fmt='none', ecolor='black',
                      yerr=100 * np.abs(ends.T - shares), elinewidth=0.9, capsize=2)
    axes.set_xticks(places, [f'{motion}\nSNR {snr:g}' for motion, snr in cases])
    axes.set(ylim=(0, 105), ylabel=f'targets found at {100 * RATE:g} % false alarms [%]')
    tidy([axes], grid=False)
    legend_above(figure, 2)


SUITE = Suite(
    'Dim targets on lines and arcs (N each), SNR 1.5 and 2, by the convex detector and by an '
    'exhaustive search over straight lines with the same statistic at the same false alarms.',
    run_dim)
