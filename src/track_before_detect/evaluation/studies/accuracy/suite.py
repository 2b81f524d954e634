"""Bright targets: position error over the Cramér-Rao bound, amplitude, second trajectories."""

from collections.abc import Mapping, Sequence
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.pictures import GREY, tidy
from track_before_detect.evaluation.engine.quantities import estimate, mean, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.studies.accuracy.runs import GHOST_PX, isolated_target
from track_before_detect.evaluation.studies.single_target import N_FRAMES, RATE, SIGMA_PX

SNRS = (5.0, 10.0, 30.0, 50.0)
SIDE_PX = 64
# Targets that are wider than the PSF that the detector is told.
WIDE_SIGMA_PX = 1.3


def run_accuracy(runs: int, seed: int, runner: Runner, *, snrs: Sequence[float] = SNRS,
                 side_px: int = SIDE_PX) -> SuiteResult:
    """Measure positions and amplitudes of bright targets."""
    threshold = runner.threshold({'false_alarm_rate': RATE}, (N_FRAMES, side_px, side_px))
    items = [item for sigma in (SIGMA_PX, WIDE_SIGMA_PX) for snr in snrs for item in items_of(
        seed, f'accuracy {snr:g}', runs, snr=snr, sigma_px=sigma, threshold=threshold,
        side_px=side_px)]
    results = runner.map(isolated_target, items, 'measuring bright targets')
    rows, quantities, curves = [], [], {}
    for item, result in zip(items, results, strict=True):
        squared = result['squared_errors']
        rows.append({
            'snr': item['snr'], 'sigma_px': item['sigma_px'], 'seed': item['seed'],
            'n_trajectories': result['n_found'],
            'n_ghosts': result['n_ghosts'],
            'rmse_px': float('nan') if squared is None else float(np.sqrt(np.mean(squared))),
            'amplitude_ratio': float('nan') if squared is None else result['amplitude']})
    for snr in snrs:
        group, wide = ([result for item, result in zip(items, results, strict=True)
                        if (item['snr'], item['sigma_px']) == (snr, sigma)]
                       for sigma in (SIGMA_PX, WIDE_SIGMA_PX))
        found = [result for result in group if result['n_found']]
        quantities.append(share(f'SNR {snr:g}: target found', len(found), runs, 'batches'))
        if not found:
            continue
        squared = np.array([result['squared_errors'] for result in found])
        bound = cramer_rao(snr)
        curves[snr] = np.sqrt(squared.mean(axis=0))
        quantities += [
            estimate(f'SNR {snr:g}: position RMSE over the bound', squared,
                     functools.partial(_over, bound=bound), 'batches', note='goal: at most 1.3'),
            estimate(f'SNR {snr:g}: the same in the worst frame', squared,
                     functools.partial(_worst_over, bound=bound), 'batches'),
            mean(f'SNR {snr:g}: amplitude over the true one',
                 [result['amplitude'] for result in found], 'batches', note='goal: 0.98 to 1.02'),
            share(f'SNR {snr:g}: no second trajectory of the target',
                  sum(result['n_ghosts'] == 0 for result in group), runs, 'batches',
                  'goal: 99 %'),
            share(f'SNR {snr:g}: no second trajectory anywhere',
                  sum(result['n_found'] <= 1 for result in group), runs, 'batches',
                  f'of noise: {100 * (1 - RATE):g} %'),
            share(f'SNR {snr:g}, target of {WIDE_SIGMA_PX:g} px: no second trajectory of it',
                  sum(result['n_ghosts'] == 0 for result in wide), runs, 'batches',
                  'goal: 95 %')]
    return SuiteResult(
        'Accuracy beside the Cramér-Rao bound',
        f'{runs} batches of {N_FRAMES} frames of {side_px} x {side_px} pixels per SNR, '
        'PSF of 1 px, one target at a random heading and a constant speed of 0.2 to 1 px/frame; '
        f'as many batches with a target of {WIDE_SIGMA_PX:g} px, of which the detector is told '
        '1 px. The bound is that of a constant velocity with free amplitudes: in frame t the '
        'variance per axis is 2 sigma^2 / SNR^2 (1/T + (t - mean)^2 / sum (t - mean)^2). A second '
        f'trajectory less than {GHOST_PX:g} px from the target on average is its own; '
        f'others are false alarms, which {100 * RATE:g} % of batches of noise have. Intervals: '
        'bootstrap over batches, Wilson for shares.',
        rows, quantities, {'threshold': threshold}, functools.partial(_draw, curves=curves))


def cramer_rao(snr: float) -> NDArray[np.float64]:
    """Return the least standard deviation of one coordinate in each frame, in pixels.

    A stamp of unit norm tells snr^2 / (2 sigma^2) about each coordinate in each frame; amplitudes
    do not disturb it, since a symmetric stamp is orthogonal to its derivatives.
    """
    times = np.arange(N_FRAMES) - 0.5 * (N_FRAMES - 1)
    return np.sqrt(2 * SIGMA_PX**2 / snr**2 * (1 / N_FRAMES + times**2 / np.sum(times**2)))


def _over(squared: NDArray, bound: NDArray) -> float:
    return float(np.sqrt(squared.mean() / np.mean(bound**2)))


def _worst_over(squared: NDArray, bound: NDArray) -> float:
    return float((np.sqrt(squared.mean(axis=0)) / bound).max())


def _draw(figure: Any, curves: Mapping[float, NDArray]) -> None:
    axes = figure.subplots()
    for number, (snr, rmse) in enumerate(curves.items()):
        colour = f'C{number}'
        axes.semilogy(rmse, 'o-', color=colour, markersize=4, label=f'SNR {snr:g}')
        axes.semilogy(cramer_rao(snr), '--', color=colour, linewidth=1)
    axes.semilogy([], [], '--', color=GREY, label='Cramér-Rao bound')
    axes.set_xticks(range(0, N_FRAMES, 5))
    axes.set(xlabel='frame', ylabel='RMSE of one coordinate [px]')
    axes.grid(alpha=0.3, which='both')
    tidy([axes], grid=False)
    figure.legend(loc='outside right upper', frameon=False)


SUITE = Suite(
    'Isolated targets at SNR 5 to 50 (N each): position error over the Cramér-Rao bound, '
    'amplitude, second trajectories.', run_accuracy)
