"""Amplitudes of constant modulus whose phase is free in each frame: shrinkage and descent.

Layout of every array
---------------------
matched, slack, amplitudes : complex128 (n, T)
    Inner products h with the data, the same less the fit, and x.
gram : float64 (n, n, T)
    Inner products of the stamps of two paths in one frame; those with itself are one, or zero
    where nothing is seen of it.
envelopes : float64 (n, T)
    In proportion to which the moduli are, of unit norm; zero where nothing is seen.
penalties : float64 (n,)
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import UNCHECKED
from track_before_detect.kernels.fit.group_lasso import dual_value

MOST_LEVELS = 1000
# Sweeps between two looks at the duality gap.
SWEEPS = 4
# Share of the fall that is wanted below which a sweep counts as the last.
SETTLED = 0.01


@numba.njit(**UNCHECKED)
def give_one_modulus(row, envelope, penalty):
    """Minimise 1/2 |x - h|^2 + penalty |x| over |x_k| = alpha c_k in place of h; return alpha.

    Each phase is that of h, and alpha is sum c |h| less the penalty.
    """
    alpha = -penalty
    for k in range(row.size):
        alpha += envelope[k] * abs(row[k])
    alpha = max(alpha, 0.0)
    for k in range(row.size):
        size = abs(row[k])
        row[k] = alpha * envelope[k] * (row[k] / size if size > 0.0 else 1.0)
    return alpha


@numba.njit(**UNCHECKED)
def clip_moduli(row, envelope, penalty):
    """Minimise 1/2 |x - h|^2 + penalty max |x_k| / c_k in place of h; return the largest.

    The moduli are clipped at s c_k, the level s such that the sum of what is cut off, times c, is
    the penalty: h less x is the projection of h on the ball of the dual norm, sum c |h|. That sum
    falls with s, convex and straight in parts, so that Newton steps from s = 0 reach its crossing
    from below in a finite number.
    """
    level = 0.0
    for _ in range(MOST_LEVELS):
        cut = -penalty
        slope = 0.0
        for k in range(row.size):
            over = abs(row[k]) - level * envelope[k]
            if over > 0.0:
                cut += envelope[k] * over
                slope += envelope[k]**2
        if not cut > 0.0 or slope == 0.0 or level + cut / slope == level:
            break
        level += cut / slope
    for k in range(row.size):
        size = abs(row[k])
        if size > level * envelope[k]:
            row[k] *= level * envelope[k] / size
    return level


@numba.njit(**UNCHECKED)
def _sweep(amplitudes, norms, slack, gram, envelopes, penalties, clipped, row):
    """Minimise path by path, once over all; return by how much the objective fell."""
    n_paths, n_frames = amplitudes.shape
    fall = 0.0
    for p in range(n_paths):
        for k in range(n_frames):
            row[k] = slack[p, k] + gram[p, p, k] * amplitudes[p, k]
            fall += 0.5 * abs(slack[p, k])**2
        fall += penalties[p] * norms[p]
        if clipped:
            norms[p] = clip_moduli(row, envelopes[p], penalties[p])
        else:
            norms[p] = give_one_modulus(row, envelopes[p], penalties[p])
        fall -= penalties[p] * norms[p]
        for k in range(n_frames):
            step = row[k] - amplitudes[p, k]
            fall -= 0.5 * abs(slack[p, k] - gram[p, p, k] * step)**2
            if step != 0.0:
                amplitudes[p, k] = row[k]
                for q in range(n_paths):
                    slack[q, k] -= gram[p, q, k] * step
    return fall


@numba.njit(**UNCHECKED)
def _set_slack(amplitudes, matched, gram, slack):
    n_paths, n_frames = amplitudes.shape
    for p in range(n_paths):
        for k in range(n_frames):
            slack[p, k] = matched[p, k]
            for q in range(n_paths):
                slack[p, k] -= gram[p, q, k] * amplitudes[q, k]


@numba.njit(**UNCHECKED)
def convex_gap(amplitudes, norms, matched, slack, envelopes, penalties, energy):
    """Return objective and duality gap of the convex problem, ``norms`` (n,) being max |x| / c."""
    shrinkage = 0.0
    cross = 0.0
    explained = 0.0
    largest = 0.0
    for p in range(amplitudes.shape[0]):
        shrinkage += penalties[p] * norms[p]
        statistic = 0.0
        for k in range(amplitudes.shape[1]):
            cross += (np.conj(matched[p, k]) * amplitudes[p, k]).real
            explained += (np.conj(slack[p, k]) * amplitudes[p, k]).real
            statistic += envelopes[p, k] * abs(slack[p, k])
        largest = max(largest, statistic / penalties[p])
    residual = 2.0 * energy - cross - explained
    objective = 0.5 * residual + shrinkage
    return objective, max(objective - dual_value(2.0 * energy - cross, residual, largest, 1.0),
                          0.0)


@numba.njit(**UNCHECKED)
def descend(amplitudes, norms, matched, gram, envelopes, penalties, clipped, energy, gap_wanted,
            most_sweeps):
    """Minimise 1/2 x'Gx - h'x + sum of w_p times the norm of x_p in place, path by path.

    The convex problem takes ``clipped`` moduli, its norm is the largest |x_k| / c_k, and it ends
    at a duality gap. Moduli in proportion to c, not ``clipped``, are no convex set: the sweeps
    never raise the objective, and end when it no longer falls.

    Returns
    -------
    float
        The duality gap, or what it would still be worth to go on.
    """
    n_paths, n_frames = amplitudes.shape
    slack = np.empty_like(amplitudes)
    row = np.empty(n_frames, amplitudes.dtype)
    for p in range(n_paths):
        norms[p] = 0.0
        for k in range(n_frames):
            if envelopes[p, k] > 0.0:
                norms[p] = max(norms[p], abs(amplitudes[p, k]) / envelopes[p, k])
    _set_slack(amplitudes, matched, gram, slack)
    left = math.inf
    for number in range(most_sweeps):
        fall = _sweep(amplitudes, norms, slack, gram, envelopes, penalties, clipped, row)
        if not clipped:
            left = abs(fall) / SETTLED
        elif number % SWEEPS == 0:
            _, left = convex_gap(amplitudes, norms, matched, slack, envelopes, penalties, energy)
        if left <= gap_wanted:
            break
    return left
