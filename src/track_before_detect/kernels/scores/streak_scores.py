"""Matched filter of streaks: sums of that of a target at rest along them."""

import numba
import numpy as np

from track_before_detect.kernels.amplitude_codes import NON_NEGATIVE
from track_before_detect.kernels.compile_flags import FUSED_UNCHECKED
from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE

_U = np.uint64


@numba.njit(**FUSED_UNCHECKED)
def _add(out, o, picture, a, n):
    for x in range(_U(n)):
        out[o + x] += picture[a + x]


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
            _add(out, _U(first), picture, _U(row * width + first + shift), width - abs(shift))


@numba.njit(**FUSED_UNCHECKED)
def _square(out, other, is_complex, positive_only):
    for x in range(_U(out.size)):
        value = out[x]
        if positive_only:
            value = max(value, np.float32(0))
        out[x] = value * value
    if is_complex:
        for x in range(_U(out.size)):
            out[x] += other[x] * other[x]


@numba.njit(**FUSED_UNCHECKED)
def _divide(out, o, squared, factors, share, n_places):
    for x in range(_U(squared.size)):
        left = share[x] / n_places
        out[o + x] = squared[x] * factors[x] / left if left > np.float32(LEAST_SHARE) else (
            np.float32(0))


@numba.njit(**FUSED_UNCHECKED)
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
    height, width = out.shape
    is_complex = imaginary.shape[0] > 0
    flat = out.reshape(out.size)
    h = np.empty(width, np.float32)
    other = np.empty(width, np.float32)
    share = np.empty(width, np.float32)
    squared_factors = np.empty(width, np.float32)
    for y in range(first_row, last_row):
        _sum_along(h, real.reshape(real.size), height, y, offsets)
        _sum_along(share, shares.reshape(shares.size), height, y, offsets)
        if is_complex:
            _sum_along(other, imaginary.reshape(imaginary.size), height, y, offsets)
        for x in range(width):
            squared_factors[x] = factors[y % n_sub, x % n_sub]**2
        _square(h, other, is_complex, model == NON_NEGATIVE and not is_complex)
        _divide(flat, _U(y * width), h, squared_factors, share, np.float32(offsets.shape[0]))
