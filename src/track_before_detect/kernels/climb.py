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
def best_amplitudes(seen, model, out):
    """Fit the amplitude of each frame to the statistic, the first column of ``seen`` (T, 3).

    Returns the sum of their squares, which is the squared statistic of the path.
    """
    n_frames = seen.shape[0]
    mean = 0.0
    for t in range(n_frames):
        mean += seen[t, 0] / n_frames
    total = 0.0
    for t in range(n_frames):
        if model == 2:
            out[t] = max(mean, 0.0)
        elif model == 1:
            out[t] = seen[t, 0]
        else:
            out[t] = max(seen[t, 0], 0.0)
        total += out[t] * out[t]
    return total


@numba.njit(**_COMPILE)
def climb(positions, basis, sigma, half, frames, valid, model, most_steps):
    """Maximise the squared statistic by damped Gauss-Newton steps.

    positions : float64 (T, 2), moved in place
    basis : float64 (T, 2, B), C-contiguous; the displacement (x, y) of each frame is basis @ c
    frames, valid : as in the module ``stamps``

    model : amplitude model, see the function ``shrink``

    Returns the squared statistic reached.
    """
    n_frames, _, n_basis = basis.shape
    rows = basis.reshape(2 * n_frames, n_basis)
    limit_x, limit_y = frames.shape[2] - 1.0, frames.shape[1] - 1.0
    seen = np.empty((n_frames, 3))
    trial_seen = np.empty((n_frames, 3))
    trial = np.empty((n_frames, 2))
    amplitudes = np.empty(n_frames)
    trial_amplitudes = np.empty(n_frames)
    normal = np.empty((n_basis, n_basis))
    right = np.empty(n_basis)
    _clip(positions, limit_x, limit_y)
    statistic_and_slope(positions, sigma, half, frames, valid, seen)
    value = best_amplitudes(seen, model, amplitudes)
    damping = 0.0
    for _ in range(most_steps):
        normal[:] = 0.0
        right[:] = 0.0
        for t in range(n_frames):
            # A unit-norm Gaussian loses d^2 / (4 sigma^2) of its statistic at distance d, so half
            # the squared statistic has this curvature; the floor keeps empty frames harmless.
            curvature = (amplitudes[t]**2 + 0.1) / (2.0 * sigma * sigma)
            for axis in range(2):
                slope = amplitudes[t] * seen[t, 1 + axis]
                for i in range(n_basis):
                    here = basis[t, axis, i]
                    if here == 0.0:
                        continue
                    right[i] += here * slope
                    for k in range(n_basis):
                        normal[i, k] += curvature * here * basis[t, axis, k]
        for i in range(n_basis):
            normal[i, i] = normal[i, i] * (1.0 + damping) + 1e-9
        step = (rows @ np.linalg.solve(normal, right)).reshape(n_frames, 2)
        largest = np.abs(step).max()
        if largest > sigma:
            step *= sigma / largest
        trial[:] = positions + step
        _clip(trial, limit_x, limit_y)
        statistic_and_slope(trial, sigma, half, frames, valid, trial_seen)
        trial_value = best_amplitudes(trial_seen, model, trial_amplitudes)
        if trial_value > value:
            gained = trial_value - value
            positions[:] = trial
            seen[:] = trial_seen
            amplitudes[:] = trial_amplitudes
            value = trial_value
            damping *= 0.3
            if gained < 1e-4 * value or largest < 1e-3 * sigma:
                break
        else:
            damping = max(4.0 * damping, 0.5)
            if damping > 1e3:
                break
    return value
