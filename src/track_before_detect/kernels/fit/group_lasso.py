"""The group lasso over the paths of a working set: descent and Newton steps to a duality gap.

Layout of every array
---------------------
matched : float64 (n, D, T), inner products with the data; D = 2 for the real and the imaginary
    part, otherwise 1
gram : float64 (n, n, T), inner products of the stamps of two paths in one frame
amplitudes, slack : float64 (n, D, T), x and matched - gram x

All paths have one weight. Paths of different weights, and frames of different weights within a
path, are columns divided by their weight: their norm in ``gram`` is then not one. Where it is the
same in all frames, the amplitudes of one path, all others fixed, have the closed form of Algorithm
2; where it is not, their norm is found on a line (Algorithm 1).
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, REORDERED_UNCHECKED, UNCHECKED
from track_before_detect.kernels.fit.least_squares import (
    backward,
    find_blocks,
    forward,
    solve_frame,
)

# Newton steps on a concave function of one variable; a handful settle all digits.
MOST_LINE_STEPS = 60
# Shorter and shorter Newton steps that are tried.
MOST_TRIALS = 6
# Rounds without a smaller gap after which there will be none.
PATIENCE = 10


@numba.njit(**EXACT)
def shrunk_norm(row, diagonal, weight):
    """Return the norm s of the minimiser of 1/2 x'Dx - h'x + weight |x| (Patent Eq. 10-11).

    The minimiser is x_k = h_k / (d_k + weight / s), the s that fits its own norm found on a line
    (Algorithm 1): s -> |x(s) / s|^-1 is concave, and a line where all entries of D are equal, so
    that Newton steps from s = 0 climb to its crossing of one and never pass it.

    Parameters
    ----------
    row : array, shape (D, T)
        h, already non-negative where the amplitudes have to be.
    diagonal : array, shape (T,)
        Entries of the diagonal matrix, above zero wherever ``row`` is not zero.
    weight : float
        Above zero.
    """
    size = 0.0
    for _ in range(MOST_LINE_STEPS):
        total = 0.0
        slope = 0.0
        for d in range(row.shape[0]):
            for k in range(row.shape[1]):
                below = size * diagonal[k] + weight
                part = (row[d, k] / below)**2
                total += part
                slope += part * diagonal[k] / below
        if total <= 1.0 or slope == 0.0:
            break
        step = (math.sqrt(total) - 1.0) * total / slope
        size += step
        if step <= 1e-15 * size:
            break
    return size


@numba.njit(**REORDERED_UNCHECKED)
def _norm(row):
    total = 0.0
    for value in row.flat:
        total += value * value
    return math.sqrt(total)


@numba.njit(**REORDERED_UNCHECKED)
def _change(slack, gram, path, step):
    """Bring the slack of all members up to date with a change of one of them."""
    n_paths, n_parts, n_frames = slack.shape
    for p in range(n_paths):
        for d in range(n_parts):
            for k in range(n_frames):
                slack[p, d, k] -= gram[path, p, k] * step[d, k]


@numba.njit(**UNCHECKED, inline='always')
def _sweep(amplitudes, slack, gram, weight, non_negative, step):
    """Minimise path by path, once over all members (Algorithm 3)."""
    n_paths, n_parts, n_frames = amplitudes.shape
    for p in range(n_paths):
        total = 0.0
        least = math.inf
        most = 0.0
        for k in range(n_frames):
            diagonal = gram[p, p, k]
            used = False
            for d in range(n_parts):
                # A masked stamp has no norm; its slack is zero and its amplitude stays so.
                value = slack[p, d, k] + diagonal * amplitudes[p, d, k]
                if non_negative and value < 0.0:
                    value = 0.0
                step[d, k] = value
                total += value * value
                used = used or value != 0.0
            if used:
                least = min(least, diagonal)
                most = max(most, diagonal)
        norm = math.sqrt(total)
        # The solution is step / (diagonal + joined).
        joined = math.inf
        if norm > weight:
            if most - least <= 1e-13 * most:
                joined = weight * most / (norm - weight)
            else:
                joined = weight / shrunk_norm(step, gram[p, p], weight)
        moved = False
        for k in range(n_frames):
            below = gram[p, p, k] + joined
            for d in range(n_parts):
                value = step[d, k] / below
                step[d, k] = value - amplitudes[p, d, k]
                moved = moved or step[d, k] != 0.0
                amplitudes[p, d, k] = value
        if moved:
            _change(slack, gram, p, step)


@numba.njit(**UNCHECKED)
def dual_scale(product, residual, largest, weight):
    """Return the scale of the residual that makes it the best feasible point of the dual."""
    scale = product / residual if residual > 0.0 else 0.0
    if scale * largest > weight:
        scale = weight / largest
    return scale


@numba.njit(**UNCHECKED)
def dual_value(product, residual, largest, weight):
    """Return the largest dual value of a multiple of the residual that is feasible.

    ``product`` is the inner product of data and residual, ``residual`` its squared norm.
    """
    scale = dual_scale(product, residual, largest, weight)
    return scale * product - 0.5 * scale * scale * residual


@numba.njit(**UNCHECKED)
def value_and_gap(amplitudes, matched, slack, weight, non_negative, energy):
    """Return objective and duality gap over the members, and their largest statistic."""
    n_paths = amplitudes.shape[0]
    shrinkage = 0.0
    cross = 0.0
    explained = 0.0
    largest = 0.0
    for p in range(n_paths):
        shrinkage += weight * _norm(amplitudes[p])
        total = 0.0
        for d in range(amplitudes.shape[1]):
            for k in range(amplitudes.shape[2]):
                cross += matched[p, d, k] * amplitudes[p, d, k]
                explained += slack[p, d, k] * amplitudes[p, d, k]
                value = slack[p, d, k]
                if non_negative and value < 0.0:
                    value = 0.0
                total += value * value
        largest = max(largest, math.sqrt(total))
    # With r the residual: r'r = y'y - x'h - x'c and y'r = y'y - x'h, c the slack.
    residual = 2.0 * energy - cross - explained
    product = 2.0 * energy - cross
    objective = 0.5 * residual + shrinkage
    return objective, max(objective - dual_value(product, residual, largest, weight), 0.0), largest


@numba.njit(**UNCHECKED)
def _copy(out, source):
    # An assignment of whole arrays compiles for seconds: its error puts shapes into words.
    for p in range(out.shape[0]):
        for d in range(out.shape[1]):
            for k in range(out.shape[2]):
                out[p, d, k] = source[p, d, k]


@numba.njit(**UNCHECKED)
def _slack(amplitudes, matched, gram, slack):
    _copy(slack, matched)
    for p in range(amplitudes.shape[0]):
        _change(slack, gram, p, amplitudes[p])


@numba.njit(**UNCHECKED, inline='always')
def _fit_block(norms, block, n, k, d, amplitudes, matched, gram, weight, non_negative, curvature):
    """Fit the paths of a block in one frame for given norms, and add its part of the curvature.

    In the variables z = x / sqrt(s) the matrix is B = S^1/2 G S^1/2 + weight. The slack
    c = weight x / s changes with s_q by -K_pq c_q, where
    weight K = G - G S^1/2 B^-1 S^1/2 G, and c_p K_pq c_q / weight is the second derivative.
    """
    matrix = np.empty((n, n))
    factor = np.empty((n, n))
    chosen = np.empty(n, np.int64)
    roots = np.empty(n)
    z = np.empty(n)
    right = np.empty(n)
    for a in range(n):
        roots[a] = math.sqrt(norms[block[a]])
        z[a] = amplitudes[block[a], d, k] / roots[a]
        right[a] = roots[a] * matched[block[a], d, k]
        for b in range(a + 1):
            value = roots[a] * roots[b] * gram[block[a], block[b], k]
            matrix[a, b] = value
            matrix[b, a] = value
        matrix[a, a] += weight
    m = solve_frame(z, right, matrix, non_negative, factor, chosen)
    for a in range(n):
        amplitudes[block[a], d, k] = roots[a] * z[a]
    if curvature.shape[0] == 0 or m < 0:
        return
    for b in range(m):
        q = block[chosen[b]]
        c_q = z[chosen[b]] / roots[chosen[b]]
        for a in range(m):
            right[a] = roots[chosen[a]] * gram[block[chosen[a]], q, k]
        forward(factor, right, m)
        backward(factor, right, m)
        for a in range(m):
            p = block[chosen[a]]
            reduced = gram[p, q, k]
            for i in range(m):
                reduced -= gram[p, block[chosen[i]], k] * roots[chosen[i]] * right[i]
            curvature[p, q] += z[chosen[a]] / roots[chosen[a]] * reduced * c_q


@numba.njit(**UNCHECKED)
def _fit_given_norms(norms, amplitudes, matched, gram, weight, non_negative, curvature):
    """Minimise 1/2 x'Gx - h'x + weight/2 sum_p |x_p|^2 / s_p in place; x_p = 0 where s_p = 0.

    ``curvature`` (n, n), unless it is of no rows, is filled with the second derivatives of the
    minimum over x by the s_p. Paths that are far apart in a frame are no concern of each other
    there, so each frame is solved block by block.
    """
    n_paths, n_parts, n_frames = amplitudes.shape
    meeting = np.zeros((n_paths, n_paths))
    order = np.empty(n_paths, np.int64)
    ends = np.empty(n_paths, np.int64)
    for p in range(n_paths):
        for q in range(curvature.shape[0]):
            curvature[p, q] = 0.0
    for k in range(n_frames):
        for p in range(n_paths):
            if norms[p] > 0.0:
                for q in range(n_paths):
                    meeting[p, q] = gram[p, q, k] if norms[q] > 0.0 else 0.0
        first = 0
        for number in range(find_blocks(meeting, order, ends)):
            block = order[first:ends[number]]
            for d in range(n_parts):
                if norms[block[0]] > 0.0:
                    _fit_block(norms, block, block.size, k, d, amplitudes, matched, gram, weight,
                               non_negative, curvature)
                else:
                    amplitudes[block[0], d, k] = 0.0
            first = ends[number]


@numba.njit(**UNCHECKED, inline='always')
def _newton_step(norms, amplitudes, matched, gram, weight, non_negative):
    """Take a Newton step on the norms of the paths, which joins what neighbours share.

    |x| is the minimum of (|x|^2 / s + s) / 2 over s, so that the norms s, one number for each
    path, are variables of a smooth convex function: its gradient is
    weight / 2 (1 - |c_p|^2 / weight^2), c the slack, and it stays smooth where a path vanishes,
    unlike the norm itself. The quadratic model is minimised over s >= 0, for the paths in use.
    """
    n_paths = norms.size
    curvature = np.empty((n_paths, n_paths))
    _fit_given_norms(norms, amplitudes, matched, gram, weight, non_negative, curvature)
    right = np.zeros(n_paths)
    for p in range(n_paths):
        if norms[p] > 0.0:
            right[p] = 0.5 * weight * ((_norm(amplitudes[p]) / norms[p])**2 - 1.0)
            for q in range(n_paths):
                right[p] += curvature[p, q] * norms[q]
    solve_frame(norms, right, curvature, np.bool_(True), np.empty((n_paths, n_paths)),
                np.empty(n_paths, np.int64))


@numba.njit(**UNCHECKED, inline='always')
def _try_newton(amplitudes, slack, matched, gram, weight, non_negative, energy, objective):
    """Improve amplitudes and slack by a Newton step on the norms; return the gap or infinity."""
    n_paths = amplitudes.shape[0]
    before, norms = np.empty(n_paths), np.empty(n_paths)
    for p in range(n_paths):
        before[p] = norms[p] = _norm(amplitudes[p])
    trial, trial_slack = np.empty(slack.shape), np.empty(slack.shape)
    _copy(trial, amplitudes)
    _newton_step(norms, trial, matched, gram, weight, non_negative)
    for _ in range(MOST_TRIALS):
        _fit_given_norms(norms, trial, matched, gram, weight, non_negative, np.empty((0, 0)))
        _slack(trial, matched, gram, trial_slack)
        reached, gap, _ = value_and_gap(trial, matched, trial_slack, weight, non_negative, energy)
        if reached <= objective + 1e-14 * energy:
            _copy(amplitudes, trial)
            _copy(slack, trial_slack)
            return gap
        for p in range(n_paths):
            norms[p] += 0.7 * (before[p] - norms[p])
    return math.inf


@numba.njit(**UNCHECKED)
def solve(amplitudes, matched, gram, slack, weight, non_negative, energy, gap_wanted, most_rounds):
    """Minimise over the members to a duality gap, in place; return (gap, rounds made).

    Sweeps of coordinate descent find which paths are active, Newton steps where they settle: the
    sweeps alone would take thousands of rounds on paths that are nearly alike.
    """
    _, n_parts, n_frames = amplitudes.shape
    row = np.empty((n_parts, n_frames))
    _slack(amplitudes, matched, gram, slack)
    gap = math.inf
    least_gap = math.inf
    latest = 0
    for rounds in range(most_rounds):
        for _ in range(2):
            _sweep(amplitudes, slack, gram, weight, non_negative, row)
        objective, gap, _ = value_and_gap(amplitudes, matched, slack, weight, non_negative,
                                          energy)
        if gap < least_gap:
            least_gap = gap
            latest = rounds
        elif rounds >= latest + PATIENCE:
            # What is left of the gap is rounding.
            break
        if gap <= gap_wanted:
            return gap, rounds + 1
        newton_gap = _try_newton(amplitudes, slack, matched, gram, weight, non_negative, energy,
                                 objective)
        if newton_gap <= gap_wanted:
            return newton_gap, rounds + 1
    return gap, most_rounds + 1


@numba.njit(**UNCHECKED)
def descend(amplitudes, matched, gram, slack, weight, non_negative, energy, gap_wanted,
            most_rounds):
    """Do what ``solve`` does by sweeps alone (Algorithm 3 with Algorithms 1 and 2)."""
    row = np.empty((amplitudes.shape[1], amplitudes.shape[2]))
    _slack(amplitudes, matched, gram, slack)
    gap = math.inf
    for rounds in range(most_rounds):
        _sweep(amplitudes, slack, gram, weight, non_negative, row)
        _, gap, _ = value_and_gap(amplitudes, matched, slack, weight, non_negative, energy)
        if gap <= gap_wanted:
            return gap, rounds + 1
    return gap, most_rounds + 1
