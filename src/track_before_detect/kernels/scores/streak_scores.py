"""Matched filter of streaks: sums of that of a target at rest along them."""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FUSED_UNCHECKED, Offset
from track_before_detect.kernels.rows import add_row
from track_before_detect.kernels.scores.score_rows import multiply, scale, score_row

_U = Offset


@numba.njit(**FUSED_UNCHECKED)
def _sum_along(out, picture, height, y, offsets):
    """Write the sum of a flat picture at the places along a streak around (y, x) to out[x]."""
    width = out.size
    out[:] = 0
    for m in range(offsets.shape[0]):
        row = y + offsets[m, 1]
        shift = offsets[m, 0]
        if 0 <= row < height and abs(shift) < width:
            first = max(0, -shift)
            add_row(out, _U(first), picture, _U(row * width + first + shift), width - abs(shift))


@numba.njit(**FUSED_UNCHECKED)
def scores_of_streak(out, left, real, imaginary, shares, offsets, factors, uneven, model, factor,
                     tilt, first_row, last_row):
    """Write what a position adds to the value of a path that leaves a streak.

    out : float32 (Y, X)
    left : float32 (Y, X), receives what weights and border leave of the squared norm of a streak;
        of no rows where that is not asked for
    real, imaginary : float32 (Y, X), inner products of the data with the unit-norm stamp at rest,
        cut and weighed but not scaled again; the imaginary part of no rows where frames are real
    shares : float32 (Y, X), what weights and border leave of the squared norm of that stamp
    offsets : int64 (M, 2), places (x, y) of the streak in grid steps from its middle
    factors : float32 (S, S), one over the norm of the sum of the stamps at the offsets, by the
        place of the middle within a pixel

    The rest is that of ``score_row``. The norm of a streak is taken as if its share left over were
    the mean of those of its places.
    """
    n_sub = factors.shape[0]
    height, width = out.shape
    other = np.empty(width if imaginary.shape[0] > 0 else 0, np.float32)
    share = np.empty(width, np.float32)
    norms = np.empty(width, np.float32)
    mean = np.float32(1 / offsets.shape[0])
    for y in range(first_row, last_row):
        for x in range(width):
            norms[x] = factors[y % n_sub, x % n_sub]
        _sum_along(share, shares.reshape(shares.size), height, y, offsets)
        scale(share, mean)
        if left.shape[0] > 0:
            left[y] = share
        _sum_along(out[y], real.reshape(real.size), height, y, offsets)
        multiply(out[y], norms)
        if imaginary.shape[0] > 0:
            _sum_along(other, imaginary.reshape(imaginary.size), height, y, offsets)
            multiply(other, norms)
        score_row(out[y], other, share, uneven, model, factor, tilt)
