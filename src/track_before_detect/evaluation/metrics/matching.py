"""Which trajectory found which target."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

# Trajectories or targets: positions of each as x and y in pixels, shape (T, 2), NaN where absent.
Paths = Sequence[NDArray] | NDArray

# A trajectory in fewer of a target's frames than this share has not found it.
LEAST_OVERLAP = 0.5


class Matching(NamedTuple):
    """Pairs of trajectory and target; each is in one pair at most.

    Attributes
    ----------
    pairs : array of int, shape (K, 2)
        Index of the trajectory, index of the target.
    distances : array, shape (K, T)
        Pixels between the two in each frame; NaN where either is absent.
    """

    pairs: NDArray[np.int64]
    distances: NDArray[np.float64]


def match_trajectories(found: Paths, targets: Paths, limit_px: float) -> Matching:
    """Pair trajectories with targets: as many as possible, then as close as possible.

    Two are a pair only where their mean distance over common frames is below ``limit_px``, and the
    trajectory is there in at least half of the target's frames.
    """
    n_frames = len(targets[0]) if len(targets) else 0
    if not len(found) or not len(targets):
        return Matching(np.zeros((0, 2), np.int64), np.zeros((0, n_frames)))
    distances = np.linalg.norm(
        np.asarray(found, float)[:, None] - np.asarray(targets, float)[None], axis=3)
    common = np.isfinite(distances)
    n_common = common.sum(axis=2)
    mean = np.where(common, distances, 0).sum(axis=2) / np.maximum(n_common, 1)
    n_present = np.isfinite(np.asarray(targets, float)).all(axis=2).sum(axis=1)
    pairs = closest_pairs(mean, (n_common >= LEAST_OVERLAP * n_present) & (n_common > 0)
                          & (mean < limit_px), limit_px)
    return Matching(pairs, distances[pairs[:, 0], pairs[:, 1]])


def closest_pairs(distances: NDArray, allowed: NDArray[np.bool_],
                  limit: float) -> NDArray[np.int64]:
    """Return as many pairs (row, column) as possible, and then as close as possible.

    Parameters
    ----------
    distances : array, shape (N, M)
        NaN only where no pair is allowed.
    allowed : array of bool, shape (N, M)
    limit : float
        The largest distance that is allowed.
    """
    # A pair that does not count costs more than all pairs that do.
    price = np.where(allowed, distances, (min(allowed.shape, default=0) + 1) * limit)
    pairs = np.column_stack(linear_sum_assignment(price))
    return pairs[allowed[pairs[:, 0], pairs[:, 1]]]
