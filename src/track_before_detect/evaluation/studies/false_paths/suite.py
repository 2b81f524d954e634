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
    LONG,
    MODELS,
    option_sets,
    side_px,
)
from track_before_detect.evaluation.studies.false_paths.fit import fitted, Maxima, maxima_of
from track_before_detect.evaluation.studies.false_paths.runs import (
    detector_for,
    noise_maxima,
    paths_of,
    study_of,
    ThoroughDetector,
)
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.solvers.calibration.false_paths import (
    corrections,
    extents,
    kind_of,
    straight_paths,
)

# Crops of one set of options, and the time that they may take by formula; options of which one
# takes longer than the last are left out.
LEAST_CROPS, MOST_CROPS, MOST_SECONDS = 40, 400, 0.4

# Seeds of the two parts of the design, the numbers of their first runs, their seconds of search by
# formula for each set of options, and their frames.
PARTS = ((7, 1000, 4.0, FRAMES), (8, 2000, 8.0, LONG))


def run_false_paths(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Search noise with ``runs`` sets of options in each part of the design; fit the table."""
    items = [item for place, first, seconds, frames in PARTS
             for number, (n_frames, options) in enumerate(option_sets(runs, place, frames))
             for item in _items(n_frames, options, seconds, [seed, first + 2 * number])]
    results = runner.map(noise_maxima, items, 'searching noise')
    known: dict[str, list[tuple[Mapping[str, Any], Maxima]]] = {}
    ranges: dict[str, list[float]] = {}
    names: list[str] = []
    for item, result in zip(items, results, strict=True):
        detector = detector_for(item['options'])
        names = _add(known, ranges, item, result['maxima'], detector)
    quantities, coefficients, rows = [], {}, []
    for kind, parts in known.items():
        found, covariance = fitted([maxima for _, maxima in parts])
        coefficients[kind] = dict(zip(names, found.tolist(), strict=True))
        for name, value, error in zip(names, found, np.sqrt(np.diag(covariance)), strict=True):
            quantities.append(Quantity(f'{kind}: {name}', float(value), float(value - 2 * error),
                                       float(value + 2 * error), len(parts), 'option sets'))
        ratios = np.array([maxima.ratio(found) for _, maxima in parts])
        quantities.append(_left_over(kind, ratios))
        rows += [{'kind': kind, 'speed': 0.0, 'travel': 0.0, **row, 'log_ratio': ratio,
                  'deviation': deviation}
                 for (row, _), (ratio, deviation) in zip(parts, ratios.tolist(), strict=True)]
    return SuiteResult(
        'Paths of noise that pass a level, for many options',
        'The largest statistics in crops of white noise, of the convex detector with options '
        'spread over the range of the table (Sobol points), and the coefficients of what '
        'corrects theory (solvers/calibration/false_paths.py). summary.json is the table.',
        rows, quantities, {'coefficients': coefficients, 'range': ranges},
        functools.partial(_draw, rows=rows))


def _items(n_frames: int, options: Mapping[str, Any], seconds: float,
           seed: list[int]) -> list[dict[str, Any]]:
    """Return the items of both amplitude models; none where a search takes too long."""
    side = side_px(n_frames, options)
    items = []
    for number, model in enumerate(MODELS):
        told = {**options, 'amplitude_model': model}
        each = study_of(detector_for(told), n_frames).seconds((side, side))
        if each <= MOST_SECONDS:
            items.append({
                'options': told, 'n_frames': n_frames, 'side_px': side,
                'n_crops': int(np.clip(round(seconds / each), LEAST_CROPS, MOST_CROPS)),
                'seed': [seed[0], seed[1] + number]})
    return items


def _add(known: dict[str, list[tuple[Mapping[str, Any], Maxima]]],
         ranges: dict[str, list[float]], item: Mapping[str, Any], values: Sequence[float],
         detector: ThoroughDetector) -> list[str]:
    """Add the maxima of an item to those of its amplitude model; return what corrects theory."""
    graph, psf, model = paths_of(detector, item['n_frames']), detector.measurement, detector.model
    assert isinstance(psf, Psf)
    crop = (item['side_px'], item['side_px'])
    names = list(corrections(graph, psf, 1.0))
    maxima = maxima_of(
        values, lambda level: straight_paths(graph, psf, model, crop, level),
        lambda level: list(corrections(graph, psf, level).values()))
    bounds = extents(graph, psf)
    known.setdefault(kind_of(model), []).append((bounds, maxima))
    for name, value in bounds.items():
        low, high = ranges.get(name, (value, value))
        ranges[name] = [min(low, value), max(high, value)]
    return names


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
    'Noise searched with 2 N sets of options and both amplitude models: the table by which '
    'thresholds are known without a search.', run_false_paths, runs=40)
