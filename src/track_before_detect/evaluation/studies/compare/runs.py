"""Scenes and single runs of the suite ``compare``: every detector on the same frames.

White noise of standard deviation 1 and unit-norm Gaussian stamps of 1 px, so SNR is the amplitude;
it is the same in all frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.metrics.gospa import trajectory_gospa
from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.evaluation.metrics.track_quality import track_quality
from track_before_detect.evaluation.studies.parallel.scenes import SIX_STATES
from track_before_detect.evaluation.studies.ring.scenes import ring_multi
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.batch_detector import BatchDetector
from track_before_detect.tracking.pipeline import DETECTOR_CLASSES

SIGMA_PX = 1.0
# (T, H, W) of most scenes, and of that of Guo et al.
USUAL, SIX = (20, 96, 96), (6, 50, 50)
MARGIN_PX = 8.0
RADIUS_PX = 20.0
APART_PX = 5.0
# Frames in which a target that enters or leaves is there.
PRESENT = 12
FOUND_PX = 2.0
# Of GOSPA: distance from which two are no pair, and price of a change of identity.
CUTOFF_PX, SWITCH_PX = 5.0, 5.0

Item = Mapping[str, Any]


def search(item: Item) -> dict[str, dict[str, float]]:
    """Search one batch by all methods.

    Parameters
    ----------
    item : mapping
        ``scene`` (of :data:`SCENES`, or ``noise`` and ``noise six``), ``snr``, ``seed``, and
        ``methods``: by name, the options of a detector with its threshold.

    Returns
    -------
    dict
        By method: targets ``found`` by a trajectory less than :data:`FOUND_PX` from them on
        average, ``false`` trajectories, the ``gospa`` distance in pixels, and the sums of the
        ``purity`` of trajectories and of the ``completeness`` of targets.
    """
    truth, searched = _searched(item)
    results = {}
    for name, trajectories in searched:
        found = [one.positions for one in trajectories]
        matched = len(match_trajectories(found, truth, FOUND_PX).pairs)
        gospa = trajectory_gospa(found, truth, cutoff_px=CUTOFF_PX, switch_px=SWITCH_PX)
        quality = track_quality(found, truth, FOUND_PX)
        results[name] = {'found': matched, 'false': len(found) - matched,
                         'gospa': gospa.distance, 'purity': float(np.sum(quality.purity)),
                         'completeness': float(np.sum(quality.completeness))}
    return results


def statistics(item: Item) -> dict[str, dict[str, list[float]]]:
    """Search one batch by all methods; arguments as of :func:`search`.

    Returns
    -------
    dict
        By method: the statistics of trajectories that are ``right``, each of another target, and
        of all others, ``false``.
    """
    truth, searched = _searched(item)
    results = {}
    for name, trajectories in searched:
        pairs = match_trajectories([one.positions for one in trajectories], truth, FOUND_PX).pairs
        right = set(pairs[:, 0].tolist())
        results[name] = {
            label: [float(one.statistic) for number, one in enumerate(trajectories)
                    if (number in right) is wanted]
            for label, wanted in (('right', True), ('false', False))}
    return results


def _searched(item):
    """Return the targets of a batch, and an iterator over method and trajectories."""
    rng = np.random.default_rng(item['seed'])
    shape = shape_of(item['scene'])
    make = SCENES.get(item['scene'])
    truth = np.zeros((0, shape[0], 2)) if make is None else make(rng)
    frames = rng.standard_normal(shape, np.float32)
    for path in truth:
        for frame, (x, y) in zip(frames, path, strict=True):
            if np.isfinite(x):
                add_target(frame, x, y, SIGMA_PX, item['snr'])
    stamps = np.arange(float(shape[0]))
    return truth, ((name, _detector(tuple(sorted(options.items()))).detect(frames, stamps).found)
                   for name, options in item['methods'].items())


def shape_of(scene: str) -> tuple[int, int, int]:
    """Return (T, H, W) of a scene."""
    return SIX if 'six' in scene else USUAL


def n_targets(scene: str) -> int:
    """Return the number of targets of a scene."""
    return len(SCENES[scene](np.random.default_rng(0)))


@functools.lru_cache(maxsize=64)
def _detector(options) -> BatchDetector:
    made = DetectorOptions.from_mapping(dict(options))
    return DETECTOR_CLASSES[made.detector](made)


def _envelope(rng, turn_radius=np.inf, speed=None):
    """Return a path about the origin at constant speed, shape (T, 2), and its heading."""
    heading = rng.uniform(0, 2 * np.pi)
    speed = rng.uniform(0.2, 1.0) if speed is None else speed
    turn = rng.choice((-1.0, 1.0)) * speed / turn_radius
    headings = heading + turn * np.arange(USUAL[0])
    path = np.cumsum(speed * _direction(headings), axis=0)
    return path - path.mean(axis=0), heading


def _direction(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _placed(rng, paths):
    """Put paths (N, T, 2) anywhere inside the frames."""
    paths = np.asarray(paths)
    low = MARGIN_PX - paths.min(axis=(0, 1))
    high = np.array([USUAL[2], USUAL[1]]) - 1 - MARGIN_PX - paths.max(axis=(0, 1))
    return paths + rng.uniform(low, high)


def _line(rng):
    return _placed(rng, [_envelope(rng)[0]])


def _arc(rng):
    return _placed(rng, [_envelope(rng, RADIUS_PX)[0]])


def _parallel(rng):
    path, heading = _envelope(rng)
    return _placed(rng, [path, path + APART_PX * _direction(heading + np.pi / 2)])


def _crossing(rng):
    path, heading = _envelope(rng, speed=0.8)
    times = np.arange(USUAL[0])[:, None] - 0.5 * (USUAL[0] - 1)
    return _placed(rng, [path, 0.8 * times * _direction(heading + np.pi / 2)])


def _enters(rng):
    path = _line(rng)
    path[:, :-PRESENT] = np.nan
    return path


def _leaves(rng):
    path = _line(rng)
    path[:, PRESENT:] = np.nan
    return path


def _six(rng) -> NDArray[np.float64]:
    times = np.arange(SIX[0])
    return np.array([np.column_stack([x + vx * times, y + vy * times])
                     for x, vx, y, vy in SIX_STATES])


# Two lines of Figure 7 of Fu et al. cross in frame 30; these are the frames about it.
SCENES: dict[str, Callable[[np.random.Generator], NDArray[np.float64]]] = {
    'line': _line, 'arc': _arc, 'two parallel': _parallel, 'two crossing': _crossing,
    'six of Guo et al.': _six, 'three of Fu et al.': lambda rng: ring_multi(3, USUAL[0], 20),
    'enters': _enters, 'leaves': _leaves,
}
