"""Many options: the largest statistics of noise, and what corrects theory for them all."""

from collections.abc import Mapping, Sequence
import functools
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.pictures import GREY, tidy
from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.studies.false_paths.design import (
    FRAMES,
    KINDS,
    LONG,
    option_sets,
    side_px,
)
from track_before_detect.evaluation.studies.false_paths.fit import fitted, Maxima, maxima_of
from track_before_detect.evaluation.studies.false_paths.runs import (
    detector_for,
    noise_maxima,
    paths_of,
    study_of,
)
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.solvers.calibration.false_paths import (
    extents,
    kind_of,
    LEVEL,
    StraightPaths,
)

# Crops of one set of options, and the time that they may take by formula; options of which one
# takes longer than the last are left out.
LEAST_CROPS, MOST_CROPS, MOST_SECONDS = 40, 400, 0.4

# Seeds of the two parts of the design, the numbers of their first runs, their seconds of search by
# formula for each set of options, and their frames.
PARTS = ((7, 1000, 4.0, FRAMES), (8, 2000, 8.0, LONG))
# Between the numbers of runs of one pair of kinds and the next.
APART = 2000


def run_false_paths(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Search noise with ``runs`` sets of options in each part of the design; fit the table."""
    items = [item for place, first, seconds, frames in PARTS
             for number, (n_frames, options) in enumerate(option_sets(runs, place, frames))
             for item in _items(n_frames, options, seconds, [seed, first + 2 * number],
                                number / runs)]
    results = runner.map(noise_maxima, items, 'searching noise')
    searched: dict[str, list[tuple[Mapping[str, Any], Sequence[float]]]] = {}
    for item, result in zip(items, results, strict=True):
        detector = detector_for(item['options'])
        kind = kind_of(detector.model, detector.presence)
        searched.setdefault(kind, []).append((item, result['maxima']))
    ranges: dict[str, list[float]] = {}
    coefficients: dict[str, dict[str, float]] = {}
    quantities, rows = [], []
    for kind, group in searched.items():
        parts = [_of(item, values, ranges, coefficients) for item, values in group]
        names = parts[0][2]
        found, covariance = fitted([maxima for _, maxima, _ in parts])
        coefficients[kind] = dict(zip(names, found.tolist(), strict=True))
        for name, value, error in zip(names, found, np.sqrt(np.diag(covariance)), strict=True):
            quantities.append(Quantity(f'{kind}: {name}', float(value), float(value - 2 * error),
                                       float(value + 2 * error), len(parts), 'option sets'))
        ratios = np.array([maxima.ratio(found) for _, maxima, _ in parts])
        quantities.append(_left_over(kind, ratios))
        rows += [{'kind': kind, 'speed': 0.0, 'travel': 0.0, **row, 'log_ratio': ratio,
                  'deviation': deviation}
                 for (row, *_), (ratio, deviation) in zip(parts, ratios.tolist(), strict=True)]
    return SuiteResult(
        'Paths of noise that pass a level, for many options',
        'The largest statistics in crops of white noise, of the convex detector with options '
        'spread over the range of the table (Sobol points), and the coefficients of what '
        'corrects theory (solvers/calibration/false_paths.py). summary.json is the table.',
        rows, quantities, {'coefficients': coefficients, 'range': ranges},
        functools.partial(_draw, rows=rows))


def _items(n_frames: int, options: Mapping[str, Any], seconds: float, seed: list[int],
           share: float) -> list[dict[str, Any]]:
    """Return the items of the kinds that go so far; none where a search takes too long."""
    side = side_px(n_frames, options)
    items = []
    for number, kind in enumerate(KINDS):
        told = {**options, **kind.options}
        if share >= kind.share:
            continue
        each = study_of(detector_for(told), n_frames).seconds((side, side))
        if each <= MOST_SECONDS:
            n_crops = round(kind.effort * seconds / each)
            items.append({
                'options': told, 'n_frames': n_frames, 'side_px': side,
                'n_crops': int(np.clip(n_crops, LEAST_CROPS, MOST_CROPS)),
                'seed': [seed[0], seed[1] + number % 2 + APART * (number // 2)]})
    return items


def _of(item: Mapping[str, Any], values: Sequence[float], ranges: dict[str, list[float]],
        coefficients: Mapping[str, Mapping[str, float]],
        ) -> tuple[Mapping[str, float], Maxima, list[str]]:
    """Return where an item is, its maxima, and what corrects theory; widen the ranges."""
    detector = detector_for(item['options'])
    graph, psf = paths_of(detector, item['n_frames']), detector.measurement
    assert isinstance(psf, Psf)
    paths = StraightPaths(graph, psf, detector.model, detector.presence,
                          (item['side_px'], item['side_px']), coefficients)
    names = list(paths.expected(LEVEL)[1])
    maxima = maxima_of(values, lambda level: paths.expected(level)[0],
                       lambda level: list(paths.expected(level)[1].values()))
    bounds = extents(graph, psf)
    for name, value in bounds.items():
        low, high = ranges.get(name, (value, value))
        ranges[name] = [min(low, value), max(high, value)]
    return bounds, maxima, names


def _left_over(kind: str, ratios: np.ndarray) -> Quantity:
    """Return by how much the rates of options differ from the table, beyond chance."""
    def beyond(part: np.ndarray) -> float:
        return float(np.sqrt(max(np.mean(part[:, 0]**2 - part[:, 1]**2), 0.0)))

    picked = np.random.default_rng(0).integers(0, len(ratios), (1000, len(ratios)))
    low, high = np.quantile([beyond(ratios[some]) for some in picked], (0.025, 0.975))
    return Quantity(f'{kind}: rates beside the table, beyond chance', beyond(ratios), float(low),
                    float(high), len(ratios), 'option sets', '%', 'one standard deviation')


def _draw(figure: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    panels = figure.subplots(1, 2, sharey=True)
    for axes, name in zip(panels, ('frames', 'segments'), strict=True):
        for kind in sorted({row['kind'] for row in rows}):
            group = [row for row in rows if row['kind'] == kind]
            ratio, deviation = (np.array([row[key] for row in group])
                                for key in ('log_ratio', 'deviation'))
            axes.errorbar([row[name] for row in group], np.exp(ratio),
                          np.exp(ratio) * deviation, fmt='.', label=kind)
        axes.axhline(1.0, color=GREY, linewidth=1)
        axes.set(xlabel=name, ylim=(0.4, 2.0))
    panels[0].set_ylabel('paths that came over those modelled')
    panels[1].legend(frameon=False, loc='upper right')
    tidy(list(panels), grid=False)


SUITE = Suite(
    'Noise searched with 2 N sets of options and several kinds of targets: the table by which '
    'thresholds are known without a search.', run_false_paths, runs=40)
