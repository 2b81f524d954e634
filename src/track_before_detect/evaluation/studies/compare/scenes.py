"""Scenes of the suite ``compare``: paths of targets in pixels, by name.

``rng`` places and directs the targets. A target has the same amplitude in all frames it is in.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.parallel.scenes import SIX_STATES
from track_before_detect.evaluation.studies.ring.scenes import ring_multi
from track_before_detect.simulation.motions import centred_path, direction

# (T, H, W) of most scenes, and of that of Guo et al.
USUAL, SIX = (20, 96, 96), (6, 50, 50)
MARGIN_PX = 8.0
RADIUS_PX = 20.0
APART_PX = 5.0
CROSSING_SPEED_PX = 0.8
# Frames in which a target that enters or leaves is there.
PRESENT = 12
# Largest speeds of targets in pixels per frame; those of Guo et al. move by up to a pixel along
# either axis.
USUAL_SPEED_PX, SIX_SPEED_PX = 1.0, 2**0.5

Paths = NDArray[np.float64]


def shape_of(scene: str) -> tuple[int, int, int]:
    """Return (T, H, W) of a scene, one of :data:`SCENES` or of noise."""
    return SIX if 'six' in scene else USUAL


def largest_speed_px(scene: str) -> float:
    """Return the largest speed of a target of a scene in any direction, pixels per frame."""
    return SIX_SPEED_PX if shape_of(scene) == SIX else USUAL_SPEED_PX


def targets_of(scene: str, rng: np.random.Generator) -> Paths:
    """Return the paths (N, T, 2) of the targets of a scene; none of one of noise."""
    make = SCENES.get(scene)
    return np.zeros((0, shape_of(scene)[0], 2)) if make is None else make(rng)


def n_targets(scene: str) -> int:
    """Return the number of targets of a scene."""
    return len(targets_of(scene, np.random.default_rng(0)))


def _path(rng: np.random.Generator, turn_radius: float = np.inf,
          speed: float | None = None) -> tuple[Paths, float]:
    """Return a path about the origin at constant speed, shape (T, 2), and its first heading."""
    heading = rng.uniform(0, 2 * np.pi)
    speed = rng.uniform(0.2, USUAL_SPEED_PX) if speed is None else speed
    turn = rng.choice((-1.0, 1.0)) * speed / turn_radius
    return centred_path(heading, speed, turn, USUAL[0]), heading


def _placed(rng: np.random.Generator, paths: Sequence[Paths]) -> Paths:
    """Put paths (N, T, 2) anywhere inside the frames."""
    low = MARGIN_PX - np.min(paths, axis=(0, 1))
    high = np.array([USUAL[2], USUAL[1]]) - 1 - MARGIN_PX - np.max(paths, axis=(0, 1))
    return np.asarray(paths) + rng.uniform(low, high)


def _line(rng: np.random.Generator) -> Paths:
    return _placed(rng, [_path(rng)[0]])


def _arc(rng: np.random.Generator) -> Paths:
    return _placed(rng, [_path(rng, RADIUS_PX)[0]])


def _parallel(rng: np.random.Generator) -> Paths:
    path, heading = _path(rng)
    return _placed(rng, [path, path + APART_PX * direction(heading + np.pi / 2)])


def _crossing(rng: np.random.Generator) -> Paths:
    path, heading = _path(rng, speed=CROSSING_SPEED_PX)
    times = np.arange(USUAL[0])[:, None] - 0.5 * (USUAL[0] - 1)
    return _placed(rng, [path, CROSSING_SPEED_PX * times * direction(heading + np.pi / 2)])


def _enters(rng: np.random.Generator) -> Paths:
    path = _line(rng)
    path[:, :-PRESENT] = np.nan
    return path


def _leaves(rng: np.random.Generator) -> Paths:
    path = _line(rng)
    path[:, PRESENT:] = np.nan
    return path


def _six(rng: np.random.Generator) -> Paths:
    times = np.arange(SIX[0])
    return np.array([np.column_stack([x + vx * times, y + vy * times])
                     for x, vx, y, vy in SIX_STATES])


# Two lines of Figure 7 of Fu et al. cross in frame 30; these are the frames about it.
SCENES: dict[str, Callable[[np.random.Generator], Paths]] = {
    'line': _line, 'arc': _arc, 'two parallel': _parallel, 'two crossing': _crossing,
    'six of Guo et al.': _six, 'three of Fu et al.': lambda rng: ring_multi(3, USUAL[0], 20),
    'enters': _enters, 'leaves': _leaves,
}
