"""Single runs of the suites ``dim``, ``accuracy`` and ``false-alarms``.

White noise of standard deviation 1 and targets that are unit-norm Gaussian stamps of 1 px, so SNR
is the amplitude.
"""

from __future__ import annotations

from collections.abc import Mapping
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.limits.line_filter import LineFilter
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.types import FrameBatch

N_FRAMES = 20
SIGMA_PX = 1.0
DIM_PX, ACCURACY_PX = 128, 64
SPEEDS_PX = (0.2, 1.0)
RADIUS_PX = 20.0
# A target is found by a trajectory whose mean error is below this; dim targets are placed this
# far inside.
FOUND_PX = 2.0
MARGIN_PX = 15.0
# A second trajectory this near to a target is made by it, not by noise.
GHOST_PX = 6 * SIGMA_PX
MODELS = ('constant', 'fluctuating')

Item = Mapping[str, Any]


def dim_target(item: Item) -> dict[str, Any]:
    """Search one batch with a dim target by both amplitude models and exhaustively.

    Parameters
    ----------
    item : mapping
        ``motion`` (``line`` or ``arc``), ``snr``, ``seed`` and ``thresholds`` by model.

    Returns
    -------
    dict
        By model: whether the detector found the target, and the largest statistic of a straight
        path within :data:`FOUND_PX` of it (None if there is none).
    """
    rng = np.random.default_rng(item['seed'])
    truth = _path(rng, item['motion']) + rng.uniform(MARGIN_PX, DIM_PX - 1 - MARGIN_PX, 2)
    frames = _frames(rng, DIM_PX, truth, item['snr'])
    found, nearby = {}, {}
    for model in MODELS:
        result = detector(model, item['thresholds'][model]).detect(
            FrameBatch.of(frames, np.arange(float(N_FRAMES))))
        errors = [np.linalg.norm(one.positions - truth, axis=1).mean() for one in result.found]
        found[model] = min(errors, default=np.inf) < FOUND_PX
        nearby[model] = line_filter(model).best_near(frames, truth, FOUND_PX)
    return {'found': {model: bool(found[model]) for model in MODELS}, 'nearby': nearby}


def dim_noise(item: Item) -> dict[str, Any]:
    """Search one batch of noise exhaustively: the largest statistic by model; needs ``seed``."""
    frames = _noise(np.random.default_rng(item['seed']), DIM_PX)
    return {model: line_filter(model).best(frames) for model in MODELS}


def isolated_target(item: Item) -> dict[str, Any]:
    """Search one batch with a bright target of constant velocity.

    Parameters
    ----------
    item : mapping
        ``snr``, ``sigma_px`` of the target, ``threshold`` and ``seed``.

    Returns
    -------
    dict
        Number of trajectories, and of those beside the strongest one that are less than
        :data:`GHOST_PX` from the target on average; of the strongest one, squared position error
        in each frame (mean over both axes) and mean amplitude over the true one, None where
        nothing was found.
    """
    rng = np.random.default_rng(item['seed'])
    truth = _path(rng, 'line') + 0.5 * (ACCURACY_PX - 1) + rng.uniform(-3, 3, 2)
    frames = _frames(rng, ACCURACY_PX, truth, item['snr'], item['sigma_px'])
    result = detector('fluctuating', item['threshold']).detect(FrameBatch.of(frames,
                                                               np.arange(float(N_FRAMES))))
    if not result.found:
        return {'n_found': 0, 'n_ghosts': 0, 'squared_errors': None, 'amplitude': None}
    best = max(result.found, key=lambda one: one.statistic)
    squared = ((best.positions - truth)**2).mean(axis=1)
    distances = [np.linalg.norm(one.positions - truth, axis=1).mean()
                 for one in result.found if one is not best]
    return {'n_found': len(result.found), 'squared_errors': squared.tolist(),
            'n_ghosts': sum(bool(distance < GHOST_PX) for distance in distances),
            'amplitude': float(best.amplitudes.mean() / item['snr'])}


def noise_alarms(item: Item) -> dict[str, Any]:
    """Search one batch of noise at several thresholds.

    Parameters
    ----------
    item : mapping
        ``side_px``, ``thresholds`` and ``seed``.

    Returns
    -------
    dict
        ``alarms``: for each threshold, whether there was a trajectory.
    """
    frames = _noise(np.random.default_rng(item['seed']), item['side_px'])
    alarms = [False] * len(item['thresholds'])
    # The search starts with the best path of all, so what a low threshold does not find, a higher
    # one does not find either.
    for number in np.argsort(item['thresholds']):
        result = detector('fluctuating', item['thresholds'][number]).detect(
            FrameBatch.of(frames, np.arange(float(N_FRAMES))))
        if not result.found:
            break
        alarms[number] = True
    return {'alarms': alarms}


@functools.lru_cache(maxsize=8)
def detector(model: str, threshold: float) -> ConvexDetector:
    """Return the convex detector with default options but these."""
    return ConvexDetector(DetectorOptions(amplitude_model=model, threshold=threshold))


@functools.lru_cache(maxsize=2)
def line_filter(model: str) -> LineFilter:
    """Return the exhaustive search with the statistic of an amplitude model."""
    return LineFilter(N_FRAMES, SPEEDS_PX[1], SIGMA_PX, model)


def _path(rng, motion) -> NDArray[np.float64]:
    """Return a path about the origin, shape (T, 2)."""
    heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(*SPEEDS_PX)
    turn = speed / RADIUS_PX * rng.choice((-1.0, 1.0)) if motion == 'arc' else 0.0
    headings = heading + turn * np.arange(N_FRAMES)
    path = np.cumsum(speed * np.column_stack([np.cos(headings), np.sin(headings)]), axis=0)
    return path - path.mean(axis=0)


def _frames(rng, side, truth, snr, sigma=SIGMA_PX):
    frames = _noise(rng, side)
    for frame, (x, y) in zip(frames, truth, strict=True):
        add_target(frame, x, y, sigma, snr)
    return frames


def _noise(rng, side):
    return rng.standard_normal((N_FRAMES, side, side), np.float32)
