"""Move a path uphill on its squared statistic within a family of smooth displacements."""

import numba
import numpy as np

from track_before_detect.kernels.amplitude_codes import (
    COMPLEX_CONSTANT,
    CONSTANT,
    NON_NEGATIVE,
    SIGNED_CONSTANT,
)
from track_before_detect.kernels.compile_flags import EXACT
from track_before_detect.kernels.fit.least_squares import backward, factorise, forward
from track_before_detect.kernels.psf.measurement import (
    curvatures,
    evaluate,
    sharpest,
    smear_curvatures,
)


@numba.njit(**EXACT)
def _clip(positions, limit_x, limit_y):
    for t in range(positions.shape[0]):
        positions[t, 0] = min(max(positions[t, 0], 0.0), limit_x)
        positions[t, 1] = min(max(positions[t, 1], 0.0), limit_y)


@numba.njit(**EXACT)
def best_amplitudes(seen, norms, model, out):
    """Fit the amplitude of each frame to the statistic, the first column of ``seen`` (T, 3).

    Constant amplitudes are in proportion to ``norms`` (T,). Returns the sum of the squares, which
    is the squared statistic of the path.
    """
    n_frames = seen.shape[0]
    product = 0.0
    square = 1e-300
    for t in range(n_frames):
        product += norms[t] * seen[t, 0]
        square += norms[t] * norms[t]
    total = 0.0
    for t in range(n_frames):
        if model == CONSTANT:
            out[t] = max(product, 0.0) / square * norms[t]
        elif model == SIGNED_CONSTANT or model == COMPLEX_CONSTANT:
            out[t] = product / square * norms[t]
        elif model == NON_NEGATIVE:
            out[t] = max(seen[t, 0], 0.0)
        else:
            out[t] = seen[t, 0]
        total += out[t] * out[t]
    return total


@numba.njit(**EXACT)
def maximise_statistic(positions, basis, compiled, limits, frames, weights, model, most_steps):
    """Maximise the squared statistic, borders and weights considered, by Gauss-Newton steps.

    positions : float64 (T, 2), moved in place
    basis : float64 (T, 2, B), C-contiguous; the displacement (x, y) of each frame is basis @ c
    compiled : CompiledMeasurement, see the module ``measurement``
    limits : float64 (2,), largest x and y
    frames, weights : as in the module ``psf_stamps``
    model : amplitude model, see the module ``amplitude_codes``

    Returns the squared statistic reached.
    """
    n_frames, _, n_basis = basis.shape
    seen = np.empty((n_frames, 3))
    trial_seen = np.empty((n_frames, 3))
    trial = np.empty((n_frames, 2))
    step = np.empty((n_frames, 2))
    amplitudes = np.empty(n_frames)
    trial_amplitudes = np.empty(n_frames)
    norms = np.empty(n_frames)
    curvature = np.empty((n_frames, 2))
    normal = np.empty((n_basis, n_basis))
    right = np.empty(n_basis)
    _clip(positions, limits[0], limits[1])
    curvatures(compiled, positions, curvature)
    smeared = compiled.maps.shape[0] == 0 and compiled.optics[0].exposure > 0.0
    cross = np.zeros(n_frames)
    if smeared:
        smear_curvatures(compiled.optics[0], positions, curvature, cross)
    sigma = sharpest(curvature)
    evaluate(compiled, positions, frames, weights, model, seen, norms)
    value = best_amplitudes(seen, norms, model, amplitudes)
    damping = 0.0
    for _ in range(most_steps):
        normal[:] = 0.0
        right[:] = 0.0
        for t in range(n_frames):
            for axis in range(2):
                # A stamp loses curvature d^2 / 2 of its statistic at distance d, and half the
                # squared statistic has as much curvature; the floor keeps empty frames harmless.
                bend = (amplitudes[t]**2 + 0.1) * curvature[t, axis]
                slope = amplitudes[t] * seen[t, 1 + axis]
                for i in range(n_basis):
                    here = basis[t, axis, i]
                    if here == 0.0:
                        continue
                    right[i] += here * slope
                    for k in range(n_basis):
                        normal[i, k] += bend * here * basis[t, axis, k]
                        if smeared:
                            normal[i, k] += ((amplitudes[t]**2 + 0.1) * cross[t] * here
                                             * basis[t, 1 - axis, k])
        for i in range(n_basis):
            normal[i, i] = normal[i, i] * (1.0 + damping) + 1e-9
        if not factorise(normal, n_basis):
            break
        forward(normal, right, n_basis)
        backward(normal, right, n_basis)
        largest = 0.0
        for t in range(n_frames):
            for axis in range(2):
                step[t, axis] = 0.0
                for i in range(n_basis):
                    step[t, axis] += basis[t, axis, i] * right[i]
                largest = max(largest, abs(step[t, axis]))
        shortened = sigma / largest if largest > sigma else 1.0
        for t in range(n_frames):
            for axis in range(2):
                trial[t, axis] = positions[t, axis] + shortened * step[t, axis]
        _clip(trial, limits[0], limits[1])
        evaluate(compiled, trial, frames, weights, model, trial_seen, norms)
        trial_value = best_amplitudes(trial_seen, norms, model, trial_amplitudes)
        if trial_value > value:
            gained = trial_value - value
            for t in range(n_frames):
                positions[t, 0], positions[t, 1] = trial[t, 0], trial[t, 1]
                for k in range(3):
                    seen[t, k] = trial_seen[t, k]
                amplitudes[t] = trial_amplitudes[t]
            value = trial_value
            damping *= 0.3
            if gained < 1e-4 * value or largest < 1e-3 * sigma:
                break
        else:
            damping = max(4.0 * damping, 0.5)
            if damping > 1e3:
                break
    return value
