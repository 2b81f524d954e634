"""Move a path uphill on its squared statistic within a family of smooth displacements."""

import numba
import numpy as np

from track_before_detect.kernels.stamps import statistic_and_slope

_COMPILE = {'nogil': True, 'cache': True}


@numba.njit(**_COMPILE)
def _clip(positions, limit_x, limit_y):
    for t in range(positions.shape[0]):
        positions[t, 0] = min(max(positions[t, 0], 0.0), limit_x)
        positions[t, 1] = min(max(positions[t, 1], 0.0), limit_y)


@numba.njit(**_COMPILE)
def squared_statistic(seen):
    """Sum of the squared positive statistics, the first column of ``seen`` (T, 3)."""
    total = 0.0
    for t in range(seen.shape[0]):
        if seen[t, 0] > 0.0:
            total += seen[t, 0] * seen[t, 0]
    return total


@numba.njit(**_COMPILE)
def climb(positions, basis, sigma, half, frames, valid, most_steps):
    """Maximise the sum of squared positive statistics by damped Gauss-Newton steps.

    positions : float64 (T, 2), moved in place
    basis : float64 (T, B), C-contiguous; the displacement in x, and that in y, is basis @ c
    frames, valid : as in the module ``stamps``

    Returns the sum reached.
    """
    n_frames, n_basis = basis.shape
    limit_x, limit_y = frames.shape[2] - 1.0, frames.shape[1] - 1.0
    seen = np.empty((n_frames, 3))
    trial_seen = np.empty((n_frames, 3))
    trial = np.empty((n_frames, 2))
    normal = np.empty((n_basis, n_basis))
    right = np.empty((n_basis, 2))
    _clip(positions, limit_x, limit_y)
    statistic_and_slope(positions, sigma, half, frames, valid, seen)
    value = squared_statistic(seen)
    damping = 0.0
    for _ in range(most_steps):
        normal[:] = 0.0
        right[:] = 0.0
        for t in range(n_frames):
            statistic = max(seen[t, 0], 0.0)
            # A unit-norm Gaussian loses d^2 / (4 sigma^2) of its statistic at distance d, so half
            # the squared statistic has this curvature; the floor keeps empty frames harmless.
            curvature = (statistic * statistic + 0.1) / (2.0 * sigma * sigma)
            for i in range(n_basis):
                right[i, 0] += basis[t, i] * statistic * seen[t, 1]
                right[i, 1] += basis[t, i] * statistic * seen[t, 2]
                for k in range(n_basis):
                    normal[i, k] += curvature * basis[t, i] * basis[t, k]
        for i in range(n_basis):
            normal[i, i] = normal[i, i] * (1.0 + damping) + 1e-9
        step = basis @ np.linalg.solve(normal, right)
        largest = np.abs(step).max()
        if largest > sigma:
            step *= sigma / largest
        trial[:] = positions + step
        _clip(trial, limit_x, limit_y)
        statistic_and_slope(trial, sigma, half, frames, valid, trial_seen)
        trial_value = squared_statistic(trial_seen)
        if trial_value > value:
            gained = trial_value - value
            positions[:] = trial
            seen[:] = trial_seen
            value = trial_value
            damping *= 0.3
            if gained < 1e-4 * value or largest < 1e-3 * sigma:
                break
        else:
            damping = max(4.0 * damping, 0.5)
            if damping > 1e3:
                break
    return value
