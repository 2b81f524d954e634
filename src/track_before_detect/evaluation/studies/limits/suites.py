"""The convex detector beside what is possible: dim targets, accuracy, false alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import functools
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.report import Quantity, share, SuiteResult
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.runs import checked_runs, seeds_of
from track_before_detect.evaluation.metrics.confidence import bootstrap_interval, wilson_interval
from track_before_detect.evaluation.studies.limits import runs as limit_runs
from track_before_detect.evaluation.studies.limits.runs import (
    ACCURACY_PX,
    DIM_PX,
    MODELS,
    N_FRAMES,
)
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.convex.detector import ConvexDetector

RATE = 0.05
DIM_SNRS = (1.5, 2.0)
MOTIONS = ('line', 'arc')
# What is asked of the detector on arcs at SNR 1.5 and on both motions at SNR 2.
_GOALS = {('arc', 1.5, 'constant'): 0.75, ('arc', 1.5, 'fluctuating'): 0.58,
          ('line', 2.0, 'constant'): 0.99, ('line', 2.0, 'fluctuating'): 0.97,
          ('arc', 2.0, 'constant'): 0.99, ('arc', 2.0, 'fluctuating'): 0.97}
# Of the largest statistics of the exhaustive search, the share its tail is fitted to.
_TAIL = 0.25
# Batches of noise searched exhaustively for each target of a line: 0.05 of its threshold is worth
# two targets of a hundred, and with one the threshold of 400 runs is known to 0.06.
NOISE_PER_RUN = 4

ACCURACY_SNRS = (5.0, 10.0, 30.0, 50.0)
# Targets that are wider than the PSF that the detector is told.
WIDE_SIGMA_PX = 1.3
# Side of the frames in pixels, batches per run asked for (rare events ask for most), rates.
ALARM_CASES = ((64, 80, (0.5, 0.05, 0.005)), (128, 8, (0.5, 0.05)), (256, 2, (0.5, 0.05)))
_COLOURS = ('#1f77b4', '#d62728')
_GREY = '#8c8c8c'


def run_dim(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Look for dim targets with the detector and exhaustively; arguments as of every suite."""
    checked_runs(runs, seed)
    thresholds = {model: _threshold(DIM_PX, RATE, runner, model) for model in MODELS}
    noise = runner.map(
        limit_runs.dim_noise,
        [{'seed': one} for one in seeds_of(seed, 'dim noise', NOISE_PER_RUN * runs)],
        'searching noise exhaustively')
    maxima = {model: np.array([result[model] for result in noise]) for model in MODELS}
    bounds = {model: _tail_quantile(maxima[model], RATE) for model in MODELS}
    cases = list(itertools.product(MOTIONS, DIM_SNRS))
    items = [{'motion': motion, 'snr': snr, 'seed': one, 'thresholds': thresholds}
             for motion, snr in cases for one in seeds_of(seed, f'dim {motion} {snr:g}', runs)]
    results = runner.map(limit_runs.dim_target, items, 'searching for dim targets')
    rows: list[dict[str, Any]] = []
    quantities = []
    for item, result in zip(items, results, strict=True):
        row = {key: item[key] for key in ('motion', 'snr', 'seed')}
        for model in MODELS:
            nearby = result['nearby'][model]
            row[f'found_{model}'] = result['found'][model]
            row[f'exhaustive_{model}'] = nearby is not None and nearby > bounds[model]
        rows.append(row)
    for (motion, snr), model in itertools.product(cases, MODELS):
        group = [row for row in rows if (row['motion'], row['snr']) == (motion, snr)]
        ours = sum(row[f'found_{model}'] for row in group)
        theirs = sum(row[f'exhaustive_{model}'] for row in group)
        name = f'{motion}, SNR {snr:g}, {model}'
        goal = _GOALS.get((motion, snr, model))
        gain = np.array([float(row[f'found_{model}']) - row[f'exhaustive_{model}']
                         for row in group])
        quantities += [
            share(f'{name}: found', ours, len(group), 'targets',
                  '' if goal is None else f'goal: {100 * goal:g} %'),
            share(f'{name}: exhaustive search', theirs, len(group), 'targets'),
            Quantity(f'{name}: found less exhaustive', float(gain.mean()),
                     *bootstrap_interval(gain, lambda drawn: float(drawn.mean())), len(group),
                     'targets', '%', 'goal: at least -3 %' if goal is None else '')]
    for model in MODELS:
        quantities.append(Quantity(
            f'threshold of the exhaustive search, {model}', bounds[model],
            *bootstrap_interval(maxima[model], lambda drawn: _tail_quantile(drawn, RATE)),
            len(noise), 'batches of noise', note=f'of the detector: {thresholds[model]:.2f}'))
    return SuiteResult(
        'Dim targets beside an exhaustive search',
        f'{runs} batches of {N_FRAMES} frames of {DIM_PX} x {DIM_PX} pixels per line, PSF of '
        '1 px, one target of constant amplitude at a random heading and a speed of 0.2 to 1 '
        f'px/frame, on lines and on arcs of {limit_runs.RADIUS_PX:g} px radius. The convex '
        f'detector with default options, {100 * RATE:g} % false alarms, with the amplitude model '
        'constant and fluctuating; found means a trajectory less than '
        f'{limit_runs.FOUND_PX:g} px from the target on average. Beside it an exhaustive search '
        'over straight lines with the same statistic on the same frames, every half pixel and '
        'every velocity up to 1 px/frame, with a threshold from the largest statistics of '
        f'{len(noise)} batches of noise, at the same rate; on lines it is the bound, on arcs it '
        'is not. Intervals: Wilson; bootstrap for thresholds and for differences on the same '
        'frames.',
        rows, quantities,
        {'runs': runs, 'seed': seed, 'false_alarm_rate': RATE, 'thresholds': thresholds},
        lambda figure: _draw_dim(figure, rows, cases))


def run_accuracy(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Measure positions and amplitudes of bright targets; arguments as of every suite."""
    checked_runs(runs, seed)
    threshold = _threshold(ACCURACY_PX, RATE, runner)
    items = [{'snr': snr, 'sigma_px': sigma, 'threshold': threshold, 'seed': one}
             for sigma in (limit_runs.SIGMA_PX, WIDE_SIGMA_PX) for snr in ACCURACY_SNRS
             for one in seeds_of(seed, f'accuracy {snr:g}', runs)]
    results = runner.map(limit_runs.isolated_target, items, 'measuring bright targets')
    rows, quantities, curves = [], [], {}
    for item, result in zip(items, results, strict=True):
        squared = result['squared_errors']
        rows.append({
            'snr': item['snr'], 'sigma_px': item['sigma_px'], 'seed': item['seed'],
            'n_trajectories': result['n_found'],
            'n_ghosts': result['n_ghosts'],
            'rmse_px': float('nan') if squared is None else float(np.sqrt(np.mean(squared))),
            'amplitude_ratio': float('nan') if squared is None else result['amplitude']})
    for snr in ACCURACY_SNRS:
        group, wide = ([result for item, result in zip(items, results, strict=True)
                        if (item['snr'], item['sigma_px']) == (snr, sigma)]
                       for sigma in (limit_runs.SIGMA_PX, WIDE_SIGMA_PX))
        found = [result for result in group if result['n_found']]
        quantities.append(share(f'SNR {snr:g}: target found', len(found), len(group), 'batches'))
        if not found:
            continue
        squared = np.array([result['squared_errors'] for result in found])
        bound = cramer_rao(snr)
        curves[snr] = np.sqrt(squared.mean(axis=0))
        amplitudes = np.array([result['amplitude'] for result in found])
        quantities += [
            Quantity(f'SNR {snr:g}: position RMSE over the bound', _over(squared, bound),
                     *bootstrap_interval(squared, functools.partial(_over, bound=bound)),
                     len(found), 'batches', note='goal: at most 1.3'),
            Quantity(f'SNR {snr:g}: the same in the worst frame', _worst_over(squared, bound),
                     *bootstrap_interval(squared, functools.partial(_worst_over, bound=bound)),
                     len(found), 'batches'),
            Quantity(f'SNR {snr:g}: amplitude over the true one', float(amplitudes.mean()),
                     *bootstrap_interval(amplitudes, lambda drawn: float(drawn.mean())),
                     len(found), 'batches', note='goal: 0.98 to 1.02'),
            share(f'SNR {snr:g}: no second trajectory of the target',
                  sum(result['n_ghosts'] == 0 for result in group), len(group), 'batches',
                  'goal: 99 %'),
            share(f'SNR {snr:g}: no second trajectory anywhere',
                  sum(result['n_found'] <= 1 for result in group), len(group), 'batches',
                  f'of noise: {100 * (1 - RATE):g} %'),
            share(f'SNR {snr:g}, target of {WIDE_SIGMA_PX:g} px: no second trajectory of it',
                  sum(result['n_ghosts'] == 0 for result in wide), len(wide), 'batches',
                  'goal: 95 %')]
    return SuiteResult(
        'Accuracy beside the Cramér-Rao bound',
        f'{runs} batches of {N_FRAMES} frames of {ACCURACY_PX} x {ACCURACY_PX} pixels per SNR, '
        'PSF of 1 px, one target at a random heading and a constant speed of 0.2 to 1 px/frame; '
        f'as many batches with a target of {WIDE_SIGMA_PX:g} px, of which the detector is told '
        '1 px. The bound is that of a constant velocity with free amplitudes: in frame t the '
        'variance per axis is 2 sigma^2 / SNR^2 (1/T + (t - mean)^2 / sum (t - mean)^2). A second '
        f'trajectory less than {limit_runs.GHOST_PX:g} px from the target on average is its own; '
        f'others are false alarms, which {100 * RATE:g} % of batches of noise have. Intervals: '
        'bootstrap over batches, Wilson for shares.',
        rows, quantities, {'runs': runs, 'seed': seed, 'threshold': threshold},
        lambda figure: _draw_accuracy(figure, curves))


def run_false_alarms(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Count batches of noise with a trajectory; arguments as of every suite."""
    checked_runs(runs, seed)
    rows, quantities = [], []
    for side, per_run, rates in ALARM_CASES:
        thresholds = [_threshold(side, rate, runner) for rate in rates]
        items = [{'side_px': side, 'thresholds': thresholds, 'seed': one}
                 for one in seeds_of(seed, f'noise {side}', per_run * runs)]
        results = runner.map(limit_runs.noise_alarms, items, f'searching noise of {side} px')
        for number, (rate, threshold) in enumerate(zip(rates, thresholds, strict=True)):
            count = sum(result['alarms'][number] for result in results)
            rows.append({'side_px': side, 'requested': rate, 'threshold': threshold,
                         'batches': len(results), 'alarms': count})
            quantities.append(share(
                f'{side} x {side} px, {100 * rate:g} % requested', count, len(results),
                'batches', f'goal: {100 * rate / 1.5:.3g} to {150 * rate:.3g} %'))
    return SuiteResult(
        'False alarms that were asked for and that came',
        f'Batches of {N_FRAMES} frames of white noise, convex detector with default options: the '
        'share with a trajectory, beside the false_alarm_rate that the threshold was made for. '
        'Intervals: Wilson.',
        rows, quantities, {'runs': runs, 'seed': seed},
        lambda figure: _draw_alarms(figure, rows))


def cramer_rao(snr: float) -> NDArray[np.float64]:
    """Return the least standard deviation of one coordinate in each frame, in pixels.

    A stamp of unit norm tells snr^2 / (2 sigma^2) about each coordinate in each frame; amplitudes
    do not disturb it, since a symmetric stamp is orthogonal to its derivatives.
    """
    times = np.arange(N_FRAMES) - 0.5 * (N_FRAMES - 1)
    return np.sqrt(2 * limit_runs.SIGMA_PX**2 / snr**2 * (
        1 / N_FRAMES + times**2 / np.sum(times**2)))


def _threshold(side, rate, runner, model='fluctuating'):
    detector = ConvexDetector(DetectorOptions(amplitude_model=model, false_alarm_rate=rate))
    return detector.threshold(np.arange(float(N_FRAMES)), (side, side), runner.progress)


def _tail_quantile(maxima, rate):
    """Return what a share ``rate`` passes; squares of the largest have an exponential tail."""
    ordered = np.sort(maxima**2)
    start = float(np.quantile(ordered, 1 - _TAIL))
    scale = float(np.mean(ordered[ordered >= start])) - start
    return float(np.sqrt(start + scale * np.log(_TAIL / rate)))


def _over(squared, bound):
    return float(np.sqrt(squared.mean() / np.mean(bound**2)))


def _worst_over(squared, bound):
    return float((np.sqrt(squared.mean(axis=0)) / bound).max())


def _draw_dim(figure, rows: Sequence[Mapping[str, Any]], cases):
    axes = figure.subplots()
    labels = [f'{motion}\nSNR {snr:g}' for motion, snr in cases]
    at = np.arange(len(cases))
    for number, (model, (kind, label)) in enumerate(itertools.product(
            MODELS, (('exhaustive', 'exhaustive straight lines'), ('found', 'convex detector')))):
        counts = [[row[f'{kind}_{model}'] for row in rows
                   if (row['motion'], row['snr']) == case] for case in cases]
        shares = np.array([np.mean(count) for count in counts])
        ends = np.array([wilson_interval(sum(count), len(count)) for count in counts])
        axes.bar(at + 0.2 * (number - 1.5), 100 * shares, 0.18, label=f'{label}, {model}',
                 color=_COLOURS[MODELS.index(model)], alpha=0.45 if kind == 'exhaustive' else 1.0)
        axes.errorbar(at + 0.2 * (number - 1.5), 100 * shares, fmt='none', ecolor='black',
                      yerr=100 * np.abs(ends.T - shares), elinewidth=0.9, capsize=2)
    axes.set_xticks(at, labels)
    axes.set_ylim(0, 105)
    axes.set_ylabel(f'targets found at {100 * RATE:g} % false alarms [%]')
    axes.spines[['top', 'right']].set_visible(False)
    figure.legend(loc='outside upper center', ncols=2, frameon=False)


def _draw_accuracy(figure, curves):
    axes = figure.subplots()
    for number, (snr, rmse) in enumerate(curves.items()):
        colour = f'C{number}'
        axes.semilogy(rmse, 'o-', color=colour, markersize=4, label=f'SNR {snr:g}')
        axes.semilogy(cramer_rao(snr), '--', color=colour, linewidth=1)
    axes.semilogy([], [], '--', color=_GREY, label='Cramér-Rao bound')
    axes.set_xticks(range(0, N_FRAMES, 5))
    axes.set_xlabel('frame')
    axes.set_ylabel('RMSE of one coordinate [px]')
    axes.grid(alpha=0.3, which='both')
    axes.spines[['top', 'right']].set_visible(False)
    figure.legend(loc='outside right upper', frameon=False)


def _draw_alarms(figure, rows):
    axes = figure.subplots()
    sides = sorted({row['side_px'] for row in rows})
    for number, side in enumerate(sides):
        group = [row for row in rows if row['side_px'] == side]
        requested = np.array([row['requested'] for row in group]) * 1.06**(number - 1)
        realised = np.array([row['alarms'] / row['batches'] for row in group])
        ends = np.array([wilson_interval(row['alarms'], row['batches']) for row in group])
        axes.errorbar(requested, realised, np.abs(ends.T - realised), fmt='o', capsize=3,
                      label=f'{side} x {side} px')
    line = np.array([0.003, 0.7])
    axes.plot(line, line, color=_GREY, linewidth=1)
    axes.fill_between(line, line / 1.5, line * 1.5, color=_GREY, alpha=0.2,
                      label='within a factor of 1.5')
    axes.set_xscale('log')
    axes.set_yscale('log')
    axes.set_xlabel('false alarm rate requested')
    axes.set_ylabel('share of batches with a trajectory')
    axes.spines[['top', 'right']].set_visible(False)
    axes.legend(frameon=False)
