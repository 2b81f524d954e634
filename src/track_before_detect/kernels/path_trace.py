"""Follow the best path back through the tables of the module ``path_search``."""

import numba
import numpy as np

from track_before_detect.kernels.path_search import ABSENT

_COMPILE = {'nogil': True, 'cache': True}


@numba.njit(**_COMPILE)
def best_arrival(before, y, x, v, segment, layout):
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


@numba.njit(**_COMPILE)
def best_velocity(before, scores, y, x, segment, layout):
    """Return the velocity of the best path that starts its last segment at (y, x)."""
    best, chosen = ABSENT, -1
    for v in range(layout.n_v):
        if segment.first_y[v] <= y < segment.last_y[v]:
            weight = np.float32(0)
            if before.size > 0:
                _, weight, _ = best_arrival(before, y, x, v, segment, layout)
            for t in range(segment.offsets.shape[1]):
                weight += scores[layout.pad + y * layout.stride + x + segment.offsets[v, t]]
            if weight > best:
                best, chosen = weight, v
    return chosen
