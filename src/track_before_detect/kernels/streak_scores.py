"""Matched filter of streaks: sums of that of a target at rest along them."""

import numba
import numpy as np

from track_before_detect.kernels.amplitude_codes import NON_NEGATIVE
from track_before_detect.kernels.stamps import LEAST_SHARE

_COMPILE = {'nogil': True, 'cache': True, 'fastmath': {'nnan', 'ninf', 'nsz', 'contract'}}


@numba.njit(**_COMPILE)
def _add_shifted(out, row, shift):
    """Add row[x + shift] to out[x] where there is one."""
    first = max(0, -shift)
    last = min(out.size, out.size - shift)
    for x in range(first, last):
        out[x] += row[x + shift]


@numba.njit(**_COMPILE)
def _sum_along(out, picture, y, offsets):
    out[:] = 0
    for m in range(offsets.shape[0]):
        row = y + offsets[m, 1]
        if 0 <= row < picture.shape[0]:
            _add_shifted(out, picture[row], offsets[m, 0])


@numba.njit(**_COMPILE)
def scores_of_streak(out, real, imaginary, shares, offsets, factors, model, first_row, last_row):
    """Write what a position adds to the value of a path that leaves a streak.

    out : float32 (Y, X)
    real, imaginary : float32 (Y, X), inner products of the data with the unit-norm stamp at rest,
        cut and weighed but not scaled again; the imaginary part of no rows where frames are real
    shares : float32 (Y, X), what weights and border leave of the squared norm of that stamp
    offsets : int64 (M, 2), places (x, y) of the streak in grid steps from its middle
    factors : float32 (S, S), one over the norm of the sum of the stamps at the offsets, by the
        place of the middle within a pixel
    model : amplitude model; those of constant amplitudes are not among them

    The norm of a streak is taken as if its share left over were the mean of those of its places.
    """
    n_sub = factors.shape[0]
    width = out.shape[1]
    h = np.empty(width, np.float32)
    other = np.empty(width, np.float32)
    share = np.empty(width, np.float32)
    for y in range(first_row, last_row):
        _sum_along(h, real, y, offsets)
        _sum_along(share, shares, y, offsets)
        if imaginary.shape[0] > 0:
            _sum_along(other, imaginary, y, offsets)
        for x in range(width):
            left = share[x] / np.float32(offsets.shape[0])
            if not left > np.float32(LEAST_SHARE):
                out[y, x] = 0
                continue
            value = h[x]
            squared = value * value
            if imaginary.shape[0] > 0:
                squared += other[x] * other[x]
            elif model == NON_NEGATIVE and value < 0:
                squared = np.float32(0)
            out[y, x] = squared * factors[y % n_sub, x % n_sub]**2 / left
