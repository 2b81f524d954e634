"""Group shrinkage and path-wise group coordinate descent in information form.

Layout of every array
---------------------
matched : float64 (P, T), h = A^T y of each path in each frame
gram : float64 (P, P, T), inner products of the unit-norm stamps of two paths in one frame
touching : bool (P, P), which paths overlap in any frame; the others are passed over
weights : float64 (P,), lambda of each path
amplitudes : float64 (P, T), x; solved in place

All columns have unit norm (or are zero), so the Gram matrix of one path is the identity and the
group shrinkage has the closed form of Algorithm 2.
"""

import math

import numba
import numpy as np

_COMPILE = {'nogil': True, 'cache': True}


@numba.njit(**_COMPILE)
def shrink(row, weight, model):
    """Shrink a vector of amplitudes towards zero by ``weight``, in place (Patent Eq. 14-15).

    ``model`` 0 keeps amplitudes non-negative, 1 lets them have any sign, 2 makes them one
    non-negative number (see the module ``amplitudes`` of the models).
    """
    if model == 2:
        mean = max(row.sum() / row.size, 0.0)
        for t in range(row.size):
            row[t] = mean
    total = 0.0
    for t in range(row.size):
        if model == 0 and row[t] < 0.0:
            row[t] = 0.0
        total += row[t] * row[t]
    norm = math.sqrt(total)
    factor = 1.0 - weight / norm if norm > weight else 0.0
    for t in range(row.size):
        row[t] *= factor


@numba.njit(**_COMPILE)
def descend(amplitudes, matched, gram, touching, weights, t_convex, model, tolerance,
            max_sweeps):
    """Minimise 1/2 x'Gx - h'x + t sum_p w_p |x_p| path by path (Algorithm 3).

    Stops when no amplitude of a sweep moved by more than ``tolerance``; returns the sweeps made,
    ``max_sweeps + 1`` when that many were not enough.
    """
    n_paths, n_frames = amplitudes.shape
    row = np.empty(n_frames)
    for sweep in range(max_sweeps):
        largest = 0.0
        for p in range(n_paths):
            for k in range(n_frames):
                row[k] = matched[p, k]
            for q in range(n_paths):
                if q != p and touching[p, q]:
                    for k in range(n_frames):
                        row[k] -= gram[p, q, k] * amplitudes[q, k]
            shrink(row, t_convex * weights[p], model)
            for k in range(n_frames):
                largest = max(largest, abs(row[k] - amplitudes[p, k]))
                amplitudes[p, k] = row[k]
        if largest <= tolerance:
            return sweep + 1
    return max_sweeps + 1
