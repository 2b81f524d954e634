"""Follow the best paths back through the tables of the module ``viterbi``."""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT
from track_before_detect.kernels.search.viterbi import ABSENT


@numba.njit(**EXACT)
def _best_arrival(before, y, x, v, segment, layout):
    """Return how the best path comes to go on from (y, x) at velocity v.

    Returns
    -------
    int
        Velocity in the segment before.
    float
        Weight of the path so far, less the cost of the turn.
    int
        Steps of the turn.
    """
    reach = segment.reach
    best, chosen, turned = ABSENT, -1, 0
    for k in range(-reach, reach + 1):
        for m in range(-reach, reach + 1):
            other = segment.velocity_at[segment.slots[v] + k * segment.columns + m]
            if other == layout.n_v:
                continue
            row, column = y - segment.arrival[other, 1], x - segment.arrival[other, 0]
            if 0 <= row < layout.n_y and 0 <= column < layout.n_x:
                steps = abs(k) + abs(m)
                weight = (before[layout.guard + (row * layout.n_v + other) * layout.stride
                                 + column] - np.float32(steps) * segment.cost)
                if weight > best:
                    best, chosen, turned = weight, other, steps
    return chosen, best, turned


@numba.njit(**EXACT)
def best_velocities(velocities, before, scores, y, x, segment, layout):
    """Write the velocity of the best path that starts its last segment at (y[i], x[i])."""
    for i in range(y.size):
        best, chosen = ABSENT, -1
        for v in range(layout.n_v):
            if segment.first_y[v] <= y[i] < segment.last_y[v]:
                weight = np.float32(0)
                if before.size > 0:
                    _, weight, _ = _best_arrival(before, y[i], x[i], v, segment, layout)
                for t in range(segment.offsets.shape[1]):
                    weight += scores[layout.pad + y[i] * layout.stride + x[i]
                                     + segment.offsets[v, t]]
                if weight > best:
                    best, chosen = weight, v
        velocities[i] = chosen


@numba.njit(**EXACT)
def step_back(y, x, velocities, turns, before, segment, layout):
    """Take paths from the start of a segment to the start of the one before, in place.

    turns : int64 (N,), raised by the steps of the turn
    """
    for i in range(y.size):
        velocity, _, turned = _best_arrival(before, y[i], x[i], velocities[i], segment, layout)
        velocities[i] = velocity
        turns[i] += turned
        x[i] -= segment.arrival[velocity, 0]
        y[i] -= segment.arrival[velocity, 1]


@numba.njit(**EXACT)
def pick_peaks(peaks, best, above, radius):
    """Write to ``peaks`` (N, 2) the y and x of separate maxima above a level, largest first.

    Positions within ``radius`` rows and columns of one that is picked are passed over. Returns
    how many are found, at most N.
    """
    best = best.copy()
    n_y, n_x = best.shape
    # The largest of each row is kept, so that a peak costs the rows around it and not all.
    at = np.empty(n_y, np.int64)
    for y in range(n_y):
        at[y] = np.argmax(best[y])
    for i in range(peaks.shape[0]):
        y = 0
        for row in range(1, n_y):
            if best[row, at[row]] > best[y, at[y]]:
                y = row
        x = at[y]
        if not best[y, x] > above:
            return i
        peaks[i, 0], peaks[i, 1] = y, x
        for row in range(max(0, y - radius), min(n_y, y + radius + 1)):
            best[row, max(0, x - radius):x + radius + 1] = ABSENT
            at[row] = np.argmax(best[row])
    return peaks.shape[0]
