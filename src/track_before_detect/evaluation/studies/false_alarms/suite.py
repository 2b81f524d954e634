"""Batches of noise: how many hold a trajectory beside the rate that was asked for."""

from collections.abc import Mapping, Sequence
import functools
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.pictures import GREY, tidy
from track_before_detect.evaluation.engine.quantities import share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.metrics.confidence import wilson_interval
from track_before_detect.evaluation.studies.false_alarms.runs import noise_alarms
from track_before_detect.evaluation.studies.single_target import N_FRAMES

# Side of the frames in pixels, batches per run asked for (rare events ask for most), rates.
CASES = ((64, 80, (0.5, 0.05, 0.005)), (128, 8, (0.5, 0.05)), (256, 2, (0.5, 0.05)))


def run_false_alarms(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Count batches of noise with a trajectory."""
    rows, quantities = [], []
    for side, per_run, rates in CASES:
        thresholds = [runner.threshold({'false_alarm_rate': rate}, (N_FRAMES, side, side))
                      for rate in rates]
        results = runner.map(
            noise_alarms, items_of(seed, f'noise {side}', per_run * runs, side_px=side,
                                   thresholds=thresholds), f'searching noise of {side} px')
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
        rows, quantities, {}, functools.partial(draw_rates, rows=[
            {**row, 'label': f'{row["side_px"]} x {row["side_px"]} px'} for row in rows]))


def draw_rates(figure: Any, rows: Sequence[Mapping[str, Any]], factor: float = 1.5) -> None:
    """Draw how many batches came beside how many were asked for, by the labels of rows."""
    axes = figure.subplots()
    for number, label in enumerate(dict.fromkeys(row['label'] for row in rows)):
        group = [row for row in rows if row['label'] == label]
        requested = np.array([row['requested'] for row in group]) * 1.06**(number - 1)
        realised = np.array([row['alarms'] / row['batches'] for row in group])
        ends = np.array([wilson_interval(row['alarms'], row['batches']) for row in group])
        axes.errorbar(requested, realised, np.abs(ends.T - realised), fmt='o', capsize=3,
                      label=label)
    line = np.array([0.003, 0.7])
    axes.plot(line, line, color=GREY, linewidth=1)
    axes.fill_between(line, line / factor, line * factor, color=GREY, alpha=0.2,
                      label=f'within a factor of {factor:g}')
    axes.set(xscale='log', yscale='log', xlabel='false alarm rate requested',
             ylabel='share of batches with a trajectory')
    tidy([axes], grid=False)
    axes.legend(frameon=False)


SUITE = Suite(
    'Batches of noise of 64, 128 and 256 px (20 N, 8 N and 2 N): how many hold a trajectory '
    'beside the rate that was asked for.', run_false_alarms)
