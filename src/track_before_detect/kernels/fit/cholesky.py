"""Cholesky factors of small matrices, in place, and the blocks that such a matrix falls into.

A factor L fills the lower triangle, its diagonal included; what is above is never read.
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import UNCHECKED


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
