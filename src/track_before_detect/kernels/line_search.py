"""The largest sum along any straight line through a batch: an exhaustive search."""

from __future__ import annotations

from numba import njit
import numpy as np


@njit(cache=True, nogil=True)
def best_lines(scores, offsets, row, best):
    """Find the best straight path of each velocity that stays inside.

    A path is centre + offset in every frame; for each velocity all centres are tried:
    best[v] <- max over centres c of sum_t scores[t, c + offsets[v, t]].

    Parameters
    ----------
    scores : float32 array, shape (T, Y, X)
        What is summed.
    offsets : int array, shape (V, T, 2)
        x and y from the centre, in places of the grid.
    row : float32 array, shape (X,)
        Scratch.
    best : float32 array, shape (V,)
        Filled; -inf for a velocity without a path inside.
    """
    n_frames, n_y, n_x = scores.shape
    for v in range(len(offsets)):
        left, top = -offsets[v, :, 0].min(), -offsets[v, :, 1].min()
        right, bottom = n_x - offsets[v, :, 0].max(), n_y - offsets[v, :, 1].max()
        left, top = max(left, 0), max(top, 0)
        right, bottom = min(right, n_x), min(bottom, n_y)
        best[v] = -np.inf
        if right <= left:
            continue
        width = right - left
        for y in range(top, bottom):
            first = left + offsets[v, 0, 0]
            row[:width] = scores[0, y + offsets[v, 0, 1], first:first + width]
            for t in range(1, n_frames):
                first = left + offsets[v, t, 0]
                _add(row[:width], scores[t, y + offsets[v, t, 1], first:first + width])
            best[v] = max(best[v], _largest(row[:width]))


@njit(cache=True, nogil=True)
def best_line_near(scores, offsets, centres, truth, limit):
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


@njit(cache=True, nogil=True)
def _add(row, values):
    for x in range(len(row)):
        row[x] += values[x]


@njit(cache=True, nogil=True, fastmath={'nnan', 'nsz', 'ninf'})
def _largest(row):
    largest = row[0]
    for x in range(1, len(row)):
        largest = max(largest, row[x])
    return largest
