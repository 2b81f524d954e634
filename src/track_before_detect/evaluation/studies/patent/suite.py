"""Figures 2-7 of US application 18/790,866 by the convex method, its continuation and greedy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.report import Quantity, SuiteResult
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.runs import checked_runs, run_seeds
from track_before_detect.evaluation.metrics.confidence import wilson_interval
from track_before_detect.evaluation.studies.patent import (
    pictures as patent_pictures,
)
from track_before_detect.evaluation.studies.patent import (
    runs as patent_runs,
)
from track_before_detect.evaluation.studies.patent.scenes import (
    COMBINATORIAL,
    CONTINUATION,
    CONVEX,
    Figure,
    FIGURES,
    FOUND_PX,
    GREEDY,
    MAX_ACCELERATION_PX,
    MAX_SPEED_PX,
    N_FRAMES,
    WIDTH_PX,
)
from track_before_detect.options import DEFAULT_CONTINUATION, DetectorOptions
from track_before_detect.tracking.pipeline import DETECTOR_CLASSES

METHODS: dict[str, dict[str, Any]] = {
    CONVEX: {'detector': 'convex', 'continuation': (1.0,)},
    CONTINUATION: {'detector': 'convex', 'continuation': DEFAULT_CONTINUATION},
    COMBINATORIAL: {'detector': 'convex', 'continuation': (0.0,)},
    GREEDY: {'detector': 'greedy'},
}


@dataclasses.dataclass(frozen=True)
class _Run:
    """What one method found in one scene."""

    figure: Figure
    method: str
    seed: int
    found: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    met: list[bool]
    threshold: float
    status: str
    cpu_s: float

    @classmethod
    def read(cls, figure: Figure, method: str, item: Mapping[str, Any],
             result: Mapping[str, Any]) -> _Run:
        """Return the run of an item."""
        scene = figure.make(np.random.default_rng(item['seed']))
        found, amplitudes = (np.array(result[key], float).reshape(-1, len(scene.measured))
                             for key in ('found', 'amplitudes'))
        met = [bool(criterion.met(scene, found)) for criterion in figure.criteria]
        return cls(figure, method, item['seed'], found, amplitudes, met,
                   item['options'][method]['threshold'], result['status'], result['cpu_s'])

    def row(self) -> dict[str, Any]:
        """Return what goes into the table."""
        met = [criterion.label
               for criterion, shown in zip(self.figure.criteria, self.met, strict=True) if shown]
        return {'figure': self.figure.number, 'seed': self.seed, 'method': self.method,
                'n_trajectories': len(self.found), 'met': '; '.join(met),
                'threshold': self.threshold, 'status': self.status, 'cpu_s': self.cpu_s}


def run_patent(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Detect the targets of each figure by each method.

    Parameters
    ----------
    runs : int
        Scenes per figure.
    seed : int
        Every scene gets a seed of its own from this one.
    runner : Runner
        Carries out the runs.

    Returns
    -------
    SuiteResult
    """
    checked_runs(runs, seed)
    made: list[_Run] = []
    pictures: dict[str, Callable[[Any], None]] = {}
    for figure, sequence in zip(
            FIGURES, np.random.SeedSequence(seed).spawn(len(FIGURES)), strict=True):
        options = {name: _calibrated(figure, method, runner)
                   for name, method in METHODS.items()}
        seeds = run_seeds(sequence, runs)
        items = [{'figure': figure.number, 'seed': one, 'options': options} for one in seeds]
        for item, results in zip(items, runner.map(
                patent_runs.measure, items, f'figure {figure.number}'), strict=True):
            made += [_Run.read(figure, name, item, result) for name, result in results.items()]
        pictures[f'figure_{figure.number}'] = _picture(
            figure, {run.method: run for run in made if run.seed == seeds[0]})
    quantities, bars = _quantities(made)
    return SuiteResult(
        'Figures 2-7 of US application 18/790,866',
        f'{runs} scenes per figure, one-dimensional, unit noise; pairs and targets lie at random '
        'parts of a pixel. Figures 2-4: one frame, PSF of 3 px, threshold 5; a pair counts the '
        f'detections near it. Figures 5-7: {N_FRAMES} frames of {WIDTH_PX} positions, PSF of '
        '2 px, false alarm rate 0.01, and one motion model: speeds up to '
        f'{MAX_SPEED_PX:g} px/frame, accelerations up to {MAX_ACCELERATION_PX:g} px/frame^2; a '
        f'target is found by a trajectory that stays within {FOUND_PX:g} px of it on average, and '
        'each trajectory counts for one target at most. Methods: convex (t = 1 only, whose '
        'optimum often shows one target as several neighbouring paths), continuation (the '
        'default schedule), t = 0 only, and greedy (one path after the other, never fitted '
        'again). The pictures show the first scene of each figure. Intervals: Wilson.',
        [run.row() for run in made], quantities,
        {'runs': runs, 'seed': seed, 'methods': METHODS, 'found_px': FOUND_PX,
         'figures': {str(figure.number): dict(figure.options) for figure in FIGURES}},
        functools.partial(patent_pictures.draw_shares, bars), pictures)


def _calibrated(figure, method, runner) -> dict[str, Any]:
    """Return the options of a method with the threshold for the scenes of a figure."""
    options = {**figure.options, **method}
    detector = DETECTOR_CLASSES[method['detector']](DetectorOptions.from_mapping(options))
    n_frames, *shape = figure.make(np.random.default_rng(0)).measured.shape
    threshold = detector.threshold(np.arange(float(n_frames)), tuple(shape), runner.progress)
    return {**options, 'threshold': threshold}


def _picture(figure, first_runs: Mapping[str, _Run]):
    """Return what draws the first scene of a figure."""
    runs = {name: (run.found, run.amplitudes) for name, run in first_runs.items()}
    run = next(iter(first_runs.values()))
    scene = figure.make(np.random.default_rng(run.seed))
    return functools.partial(patent_pictures.draw_figure, figure, scene, runs, run.threshold)


def _quantities(made):
    """Return the lines of the report, and the shares by figure, criterion and method."""
    quantities, bars = [], []
    for figure in FIGURES:
        for number, criterion in enumerate(figure.criteria):
            shares = {}
            for method in METHODS:
                shown = [run.met[number] for run in made
                         if run.figure is figure and run.method == method]
                share = sum(shown) / len(shown)
                shares[method] = (share, *wilson_interval(sum(shown), len(shown)))
                quantities.append(Quantity(
                    f'Fig. {figure.number}, {criterion.label}: {method}', *shares[method],
                    len(shown), 'scenes', '%', criterion.goals.get(method, '')))
            bars.append((f'Fig. {figure.number}: {criterion.label}', shares))
    for method in METHODS:
        of_method = [run for run in made if run.method == method]
        ended = sum(run.status == 'converged' for run in of_method)
        quantities.append(Quantity(
            f'converged: {method}', ended / len(of_method),
            *wilson_interval(ended, len(of_method)), len(of_method), 'scenes', '%'))
    return quantities, bars
