"""Figures 2-7 of US application 18/790,866 by the convex method, its continuation and greedy."""

from collections.abc import Callable, Mapping
import functools
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.quantities import Quantity, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import run_seeds
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.studies.patent import runs as patent_runs
from track_before_detect.evaluation.studies.patent import scenes
from track_before_detect.evaluation.studies.patent.figures import (
    COMBINATORIAL,
    CONTINUATION,
    CONVEX,
    Figure,
    FIGURES,
    FOUND_PX,
    GREEDY,
)
from track_before_detect.evaluation.studies.patent.pictures import draw_figure, draw_shares
from track_before_detect.options import DEFAULT_CONTINUATION

METHODS: dict[str, dict[str, Any]] = {
    CONVEX: {'detector': 'convex', 'continuation': (1.0,)},
    CONTINUATION: {'detector': 'convex', 'continuation': DEFAULT_CONTINUATION},
    COMBINATORIAL: {'detector': 'convex', 'continuation': (0.0,)},
    GREEDY: {'detector': 'greedy'},
}


Run = dict[str, Any]


def _read(figure: Figure, method: str, item: Mapping[str, Any], result: Mapping[str, Any]) -> Run:
    """Return what one method found in one scene, and which criteria that meets."""
    scene = figure.make(np.random.default_rng(item['seed']))
    found, amplitudes = (np.array(result[key], float).reshape(-1, len(scene.measured))
                         for key in ('found', 'amplitudes'))
    return {'figure': figure, 'method': method, 'seed': item['seed'], 'found': found,
            'amplitudes': amplitudes,
            'met': [bool(criterion.met(scene, found)) for criterion in figure.criteria],
            'threshold': item['options'][method]['threshold'], 'status': result['status'],
            'cpu_s': result['cpu_s']}


def _row(run: Run) -> dict[str, Any]:
    """Return what goes into the table."""
    met = [criterion.label
           for criterion, shown in zip(run['figure'].criteria, run['met'], strict=True) if shown]
    return {'figure': run['figure'].number, 'seed': run['seed'], 'method': run['method'],
            'n_trajectories': len(run['found']), 'met': '; '.join(met),
            **{key: run[key] for key in ('threshold', 'status', 'cpu_s')}}


def run_patent(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Detect the targets of each figure, in as many scenes of it, by each method."""
    made: list[Run] = []
    pictures: dict[str, Callable[[Any], None]] = {}
    for figure, sequence in zip(
            FIGURES, np.random.SeedSequence(seed).spawn(len(FIGURES)), strict=True):
        shape = figure.make(np.random.default_rng(0)).measured.shape
        options = {name: {**figure.options, **method, 'threshold': runner.threshold(
            {**figure.options, **method}, shape)} for name, method in METHODS.items()}
        seeds = run_seeds(sequence, runs)
        items = [{'figure': figure.number, 'seed': one, 'options': options} for one in seeds]
        for item, results in zip(items, runner.map(
                patent_runs.measure, items, f'figure {figure.number}'), strict=True):
            made += [_read(figure, name, item, result) for name, result in results.items()]
        pictures[f'figure_{figure.number}'] = _picture(
            figure, {run['method']: run for run in made if run['seed'] == seeds[0]})
    shares = _shares(made)
    return SuiteResult(
        'Figures 2-7 of US application 18/790,866',
        f'{runs} scenes per figure, one-dimensional, unit noise; pairs and targets lie at random '
        'parts of a pixel. Figures 2-4: one frame, PSF of 3 px, threshold 5; a pair counts the '
        f'detections near it. Figures 5-7: {scenes.N_FRAMES} frames of {scenes.WIDTH_PX} '
        'positions, PSF of 2 px, false alarm rate 0.01, and one motion model: speeds up to '
        f'{scenes.MAX_SPEED_PX:g} px/frame, accelerations up to '
        f'{scenes.MAX_ACCELERATION_PX:g} px/frame^2; a '
        f'target is found by a trajectory that stays within {FOUND_PX:g} px of it on average, and '
        'each trajectory counts for one target at most. Methods: convex (t = 1 only, whose '
        'optimum often shows one target as several neighbouring paths), continuation (the '
        'default schedule), t = 0 only, and greedy (one path after the other, never fitted '
        'again). The pictures show the first scene of each figure. Intervals: Wilson.',
        list(map(_row, made)),
        [*(one for by_method in shares.values() for one in by_method.values()),
         *(_converged(method, made) for method in METHODS)],
        {'methods': METHODS, 'found_px': FOUND_PX,
         'figures': {str(figure.number): dict(figure.options) for figure in FIGURES}},
        functools.partial(draw_shares, shares=shares), pictures)


def _picture(figure: Figure, first_runs: Mapping[str, Run]) -> Callable[[Any], None]:
    """Return what draws the first scene of a figure."""
    found = {name: (run['found'], run['amplitudes']) for name, run in first_runs.items()}
    run = next(iter(first_runs.values()))
    scene = figure.make(np.random.default_rng(run['seed']))
    return functools.partial(draw_figure, figure=figure, scene=scene, found=found,
                             threshold=run['threshold'])


def _shares(made: list[Run]) -> dict[str, dict[str, Quantity]]:
    """Return how many scenes show what, by figure and criterion, and by method."""
    shares: dict[str, dict[str, Quantity]] = {}
    for figure in FIGURES:
        for number, criterion in enumerate(figure.criteria):
            by_method = shares[f'Fig. {figure.number}: {criterion.label}'] = {}
            for method in METHODS:
                met = [run['met'][number] for run in made
                       if run['figure'] is figure and run['method'] == method]
                by_method[method] = share(
                    f'Fig. {figure.number}, {criterion.label}: {method}', sum(met), len(met),
                    'scenes', criterion.goals.get(method, ''))
    return shares


def _converged(method: str, made: list[Run]) -> Quantity:
    ended = [run['status'] == 'converged' for run in made if run['method'] == method]
    return share(f'converged: {method}', sum(ended), len(ended), 'scenes')


SUITE = Suite(
    'Figures 2-7 of US application 18/790,866 (N scenes each) by the convex method, its '
    'continuation, t = 0 only and greedy: how often each shows what the text describes.',
    run_patent)
