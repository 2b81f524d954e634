"""The largest sum along any straight line through a batch: an exhaustive search."""

from numba import njit
import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.compile_flags import EXACT, FINITE


@njit(**EXACT)
def best_lines(scores: NDArray, offsets: NDArray, row: NDArray, best: NDArray) -> None:
    """Find the best straight path of each velocity that stays inside.

    A path is centre + offset in every frame; for each velocity all centres are tried:
    best[v] <- max over centres c of sum_t scores[t, c + offsets[v, t]].

    Parameters
    ----------
    scores : float32 array, shape (T, Y, X), C-contiguous
        What is summed.
    offsets : int array, shape (V, T, 2)
        x and y from the centre, in places of the grid.
    row : float32 array, shape (X,)
        Scratch.
    best : float32 array, shape (V,)
        Filled; -inf for a velocity without a path inside.
    """
    n_frames, n_y, n_x = scores.shape
    n_velocities = len(offsets)
    flat = scores.reshape(-1)
    first = np.empty(n_frames, np.uint64)
    left, top, right, bottom = np.empty((4, n_velocities), np.int64)
    for v in range(n_velocities):
        left[v] = max(-offsets[v, :, 0].min(), 0)
        right[v] = min(n_x - offsets[v, :, 0].max(), n_x)
        top[v] = max(-offsets[v, :, 1].min(), 0)
        bottom[v] = min(n_y - offsets[v, :, 1].max(), n_y)
        best[v] = -np.inf
    # All velocities of one row of centres before the next: the rows they reach stay in the cache.
    for y in range(n_y):
        for v in range(n_velocities):
            if right[v] <= left[v] or not top[v] <= y < bottom[v]:
                continue
            width = np.uint64(right[v] - left[v])
            for t in range(n_frames):
                first[t] = ((t * n_y + y + offsets[v, t, 1]) * n_x
                            + left[v] + offsets[v, t, 0])
            _add(row, flat, first, width)
            best[v] = max(best[v], _largest(row, width))


@njit(**EXACT)
def best_line_near(scores: NDArray, offsets: NDArray, centres: NDArray, truth: NDArray,
                   limit: float) -> float:
    """Return the largest sum along a path that stays inside and near a target, -inf without one.

    Parameters
    ----------
    scores : float32 array, shape (T, Y, X)
        What is summed.
    offsets : int array, shape (V, T, 2)
        x and y from the centre, in places of the grid.
    centres : int array, shape (C, 2)
        x and y, tried for each velocity.
    truth : float array, shape (T, 2)
        Positions of the target, in places.
    limit : float
        A path is near when it is less than this away on average, in places.
    """
    n_frames, n_y, n_x = scores.shape
    best = -np.inf
    for v in range(len(offsets)):
        for centre in centres:
            total, distance, inside = 0.0, 0.0, True
            for t in range(n_frames):
                x, y = centre[0] + offsets[v, t, 0], centre[1] + offsets[v, t, 1]
                if not (0 <= x < n_x and 0 <= y < n_y):
                    inside = False
                    break
                distance += np.hypot(x - truth[t, 0], y - truth[t, 1])
                total += scores[t, y, x]
            if inside and distance < limit * n_frames:
                best = max(best, total)
    return best


@njit(**EXACT)
def _add(row: NDArray, flat: NDArray, first: NDArray, width: int) -> None:
    """Fill a row with the sum of the rows that begin at ``first`` (T,), four at a time."""
    n_frames = len(first)
    for x in range(width):
        row[x] = 0.0
    for t in range(0, n_frames - n_frames % 4, 4):
        a, b, c, d = first[t], first[t + 1], first[t + 2], first[t + 3]
        for x in range(width):
            row[x] += (flat[a + x] + flat[b + x]) + (flat[c + x] + flat[d + x])
    for t in range(n_frames - n_frames % 4, n_frames):
        a = first[t]
        for x in range(width):
            row[x] += flat[a + x]


@njit(**FINITE)
def _largest(row: NDArray, width: int) -> float:
    largest = row[0]
    for x in range(1, width):
        largest = max(largest, row[x])
    return largest
