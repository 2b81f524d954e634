"""From one coordinate in each frame to one trajectory (Fu et al. 2022, Algorithm 2, Step 3)."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

# Frames that a prediction is fitted to, and predictions in a row after which a target is lost.
FITTED_FRAMES = 5
MOST_PREDICTIONS = 5
# Score of a coordinate that a trajectory starts from, that was predicted, that was found.
INITIAL, PREDICTED, MATCHED = 1, 2, 3


@dataclass(frozen=True)
class LinkedTrajectory:
    """A trajectory in whole pixels.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y; NaN in frames without it.
    score : int
        Sum of 1 for each of the two coordinates it starts from, 2 for each predicted and 3 for
        each matched one.
    """

    positions: NDArray[np.float64]
    score: int


class _OpenTrajectory:
    """A trajectory that is being followed."""

    def __init__(self, first_frame: int, points: list[tuple[int, int]]):
        self.first_frame = first_frame
        self.points = points
        self.score = INITIAL * len(points)
        self.predictions = 0


def best_trajectory(coordinates: NDArray, v_max: int,
                    shape: tuple[int, int]) -> LinkedTrajectory | None:
    """Return the trajectory of the highest score, the earliest of equal ones; None without any.

    Two coordinates of successive frames within ``v_max`` in x and y start a trajectory. A straight
    line through its last five frames predicts the next; the coordinate of that frame is taken
    where it is within a window of 3 x 3 pixels around the prediction, two pixels wider after each
    miss, and the prediction itself elsewhere. A sixth miss in a row, or a prediction outside the
    frame, ends it.

    Parameters
    ----------
    coordinates : array of int, shape (T, 2)
        x and y of the pixel with the largest merit function in each frame.
    v_max : int
        Largest velocity in pixels per frame.
    shape : tuple of int
        (H, W) of the frames.
    """
    followed: list[_OpenTrajectory] = []
    ended: list[_OpenTrajectory] = []
    # Coordinate of the frame before, unless a trajectory has it.
    free = None
    for t, (x, y) in enumerate(np.asarray(coordinates).tolist()):
        taken = False
        for trajectory in followed[:]:
            at_x, at_y = _predicted(trajectory.points)
            if not (0 <= at_x < shape[1] and 0 <= at_y < shape[0]):
                followed.remove(trajectory)
                ended.append(trajectory)
            elif max(abs(x - at_x), abs(y - at_y)) <= 1 + trajectory.predictions:
                trajectory.points.append((x, y))
                trajectory.score += MATCHED
                trajectory.predictions = 0
                taken = True
            else:
                trajectory.points.append((at_x, at_y))
                trajectory.score += PREDICTED
                trajectory.predictions += 1
                if trajectory.predictions > MOST_PREDICTIONS:
                    followed.remove(trajectory)
                    ended.append(trajectory)
        if not taken and free is not None and max(abs(x - free[0]), abs(y - free[1])) <= v_max:
            followed.append(_OpenTrajectory(t - 1, [free, (x, y)]))
            taken = True
        free = None if taken else (x, y)
    found = sorted(ended + followed, key=lambda one: (-one.score, one.first_frame))
    if not found:
        return None
    best = found[0]
    positions = np.full((len(coordinates), 2), np.nan)
    positions[best.first_frame:best.first_frame + len(best.points)] = best.points
    return LinkedTrajectory(positions, best.score)


def _predicted(points: list[tuple[int, int]]) -> tuple[int, int]:
    """Return the pixel that a straight line through the last points reaches next."""
    last = points[-FITTED_FRAMES:]
    weights = _WEIGHTS[len(last)]
    x, y = (math.floor(sum(w * point[axis] for w, point in zip(weights, last, strict=True)) + 0.5)
            for axis in (0, 1))
    return x, y


def _extrapolation(n_points: int) -> tuple[float, ...]:
    """Weights with which ``n_points`` points make up the next one on their least-squares line."""
    ahead = np.arange(n_points) - (n_points - 1) / 2
    return tuple(1 / n_points + ahead * (n_points + 1) / 2 / np.sum(ahead**2))


_WEIGHTS = {n_points: _extrapolation(n_points) for n_points in range(2, FITTED_FRAMES + 1)}
