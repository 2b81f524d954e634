"""Amplitudes without shrinkage (t = 0): least squares in each frame, by the active-set method.

Layout of every array as in the module ``group_lasso``. No norm joins the frames, so each is a
problem of its own, of as many unknowns as there are paths. Its matrix falls into blocks, each with
a Cholesky factor L that fills the lower triangle; what is above is never read.
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import UNCHECKED, ZERO

# Added to the diagonal, relative to it, so that paths that are the same have a factor.
_RIDGE = 1e-12
# Slope, over the largest, below which a path that is left out would not lower the objective.
_LEAST_SLOPE = 1e-10


@numba.njit(**UNCHECKED)
def factorise(matrix, n):
    """Replace the lower triangle of n rows by the Cholesky factor; False when there is none."""
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if j < i:
                matrix[i, j] = rest / matrix[j, j]
            elif rest <= 0.0:
                return False
            else:
                matrix[i, i] = math.sqrt(rest)
    return True


@numba.njit(**UNCHECKED)
def forward(factor, vector, n):
    """Replace a vector b of n entries by L^-1 b."""
    for i in range(n):
        rest = vector[i]
        for j in range(i):
            rest -= factor[i, j] * vector[j]
        vector[i] = rest / factor[i, i]


@numba.njit(**UNCHECKED)
def backward(factor, vector, n):
    """Replace a vector b of n entries by L^-T b."""
    for i in range(n - 1, -1, -1):
        vector[i] /= factor[i, i]
        for j in range(i):
            vector[j] -= factor[i, j] * vector[i]


@numba.njit(**UNCHECKED)
def find_blocks(matrix, order, ends):
    """Order the rows of a symmetric matrix so that it is block-diagonal.

    Fills ``order`` and the end of each block in it, ``ends``; returns the number of blocks.
    """
    n = matrix.shape[0]
    n_blocks = 0
    seen = np.zeros(n, np.bool_)
    n_ordered = 0
    for first in range(n):
        if seen[first]:
            continue
        seen[first] = True
        order[n_ordered] = first
        looked_at = n_ordered
        n_ordered += 1
        while looked_at < n_ordered:
            p = order[looked_at]
            looked_at += 1
            for q in range(n):
                if matrix[p, q] != 0.0 and not seen[q]:
                    seen[q] = True
                    order[n_ordered] = q
                    n_ordered += 1
        ends[n_blocks] = n_ordered
        n_blocks += 1
    return n_blocks


@numba.njit(**UNCHECKED, inline='always')
def _solve_chosen(chosen, n, matched, gram, factor, solution):
    """Fill the least-squares solution over the first n of the chosen paths."""
    ridge = _RIDGE
    while True:
        for a in range(n):
            for b in range(a + 1):
                factor[a, b] = gram[chosen[a], chosen[b]]
            factor[a, a] *= 1.0 + ridge
            solution[a] = matched[chosen[a]]
        if factorise(factor, n):
            break
        ridge *= 100.0
    forward(factor, solution, n)
    backward(factor, solution, n)


@numba.njit(**UNCHECKED)
def solve_frame(x, matched, gram, non_negative, factor, chosen):
    """Minimise 1/2 x'Gx - h'x in place from a feasible start (Lawson and Hanson's method).

    Fills ``chosen`` with the paths that are not held at zero and ``factor`` with the Cholesky
    factor of their part of G. Returns their number, less one and negated when the conditions of
    the optimum were not reached.
    """
    n = x.size
    largest = 0.0
    solution = np.empty(n)
    inside = np.zeros(n, np.bool_)
    barred = np.zeros(n, np.bool_)
    for p in range(n):
        if gram[p, p] > 0.0:
            largest = max(largest, abs(matched[p]))
            inside[p] = x[p] > 0.0 or not non_negative
        else:
            x[p] = 0.0
            barred[p] = True
    n_chosen = ZERO
    for _ in range(10 * n + 10):
        n_chosen = ZERO
        for p in range(n):
            if inside[p]:
                chosen[n_chosen] = p
                n_chosen += 1
        _solve_chosen(chosen, n_chosen, matched, gram, factor, solution)
        # Towards the solution as far as no amplitude changes its sign.
        share = 1.0
        first = -1
        if non_negative:
            for a in range(n_chosen):
                if solution[a] <= 0.0:
                    value = x[chosen[a]]
                    reached = value / (value - solution[a]) if value > 0.0 else 0.0
                    if first < 0 or reached < share:
                        share = reached
                        first = chosen[a]
        for a in range(n_chosen):
            x[chosen[a]] += share * (solution[a] - x[chosen[a]])
        if first >= 0:
            x[first] = 0.0
            inside[first] = False
            # What rounding drives out at once must not be taken in again at this point.
            barred[first] = share == 0.0
            continue
        if not non_negative:
            return n_chosen
        steepest = _LEAST_SLOPE * largest
        best = -1
        for p in range(n):
            if not inside[p] and not barred[p]:
                slope = matched[p]
                for q in range(n):
                    slope -= gram[p, q] * x[q]
                if slope > steepest:
                    steepest = slope
                    best = p
        if best < 0:
            return n_chosen
        inside[best] = True
    return -1 - n_chosen


@numba.njit(**UNCHECKED)
def solve(amplitudes, matched, gram, non_negative):
    """Minimise over the members, in place; return whether every frame was solved."""
    n_paths, n_parts, n_frames = amplitudes.shape
    of_frame = np.empty((n_paths, n_paths))
    order = np.empty(n_paths, np.int64)
    ends = np.empty(n_paths, np.int64)
    solved = True
    for k in range(n_frames):
        for a in range(n_paths):
            for b in range(n_paths):
                of_frame[a, b] = gram[a, b, k]
        first = 0
        for number in range(find_blocks(of_frame, order, ends)):
            n = ends[number] - first
            matrix = np.empty((n, n))
            factor = np.empty((n, n))
            chosen = np.empty(n, np.int64)
            x = np.empty(n)
            right = np.empty(n)
            for a in range(n):
                for b in range(n):
                    matrix[a, b] = of_frame[order[first + a], order[first + b]]
            for d in range(n_parts):
                for a in range(n):
                    x[a] = amplitudes[order[first + a], d, k]
                    right[a] = matched[order[first + a], d, k]
                if solve_frame(x, right, matrix, non_negative, factor, chosen) < 0:
                    solved = False
                for a in range(n):
                    amplitudes[order[first + a], d, k] = x[a]
            first = ends[number]
    return solved
