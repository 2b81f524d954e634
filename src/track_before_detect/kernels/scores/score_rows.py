"""What positions add to the value of a path, from what a matched filter sees there."""

import numba
import numpy as np

from track_before_detect.kernels.amplitude_codes import (
    COMPLEX_CONSTANT,
    CONSTANT,
    NON_NEGATIVE,
    SIGNED_CONSTANT,
)
from track_before_detect.kernels.compile_flags import FUSED
from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE


@numba.njit(**FUSED)
def multiply(row, factors):
    """Multiply numbers by factors of their own."""
    for x in range(row.size):
        row[x] *= factors[x]


@numba.njit(**FUSED)
def square_positive(row):
    """Square numbers, those below zero as zero."""
    for x in range(row.size):
        value = row[x] if row[x] > 0 else np.float32(0)
        row[x] = value * value


@numba.njit(**FUSED)
def square(row):
    """Square numbers."""
    for x in range(row.size):
        row[x] *= row[x]


@numba.njit(**FUSED)
def _add_square(row, other):
    for x in range(row.size):
        row[x] = row[x] * row[x] + other[x] * other[x]


@numba.njit(**FUSED)
def root(row):
    """Take the root of numbers."""
    for x in range(row.size):
        row[x] = np.sqrt(row[x])


@numba.njit(**FUSED)
def scale(row, factor):
    """Multiply numbers by one factor."""
    for x in range(row.size):
        row[x] *= factor


@numba.njit(**FUSED)
def _over_norm(row, share):
    for x in range(row.size):
        left = share[x] > np.float32(LEAST_SHARE)
        row[x] = row[x] / np.sqrt(share[x]) if left else np.float32(0)


@numba.njit(**FUSED)
def _less_share(row, share, factor, tilt):
    for x in range(row.size):
        left = share[x] > np.float32(LEAST_SHARE)
        row[x] = factor * row[x] - tilt * share[x] if left else np.float32(0)


@numba.njit(**FUSED)
def score_row(row, other, share, uneven, model, factor, tilt):
    """Turn what is seen at the positions of a row into what they add to the value of a path.

    With h the matched filter statistic that is max(h, 0)^2, h^2 or |h|^2 where amplitudes may
    fluctuate, and factor * h or factor * |h| where they are constant; where their norms n are
    ``uneven``, factor * n h - tilt * n^2.

    row, other : float32 (X,), n h, real and imaginary part; none of that where frames are real
    share : float32 (X,), n^2, what is left of the squared norm; none where row is h already
    """
    if share.size > 0 and not uneven:
        _over_norm(row, share)
        if other.size > 0:
            _over_norm(other, share)
    if other.size > 0:
        _add_square(row, other)
        if model == COMPLEX_CONSTANT:
            root(row)
    elif model == NON_NEGATIVE:
        square_positive(row)
    elif model < CONSTANT:
        square(row)
    if model == CONSTANT or model == SIGNED_CONSTANT or model == COMPLEX_CONSTANT:
        if uneven:
            _less_share(row, share, np.float32(factor), np.float32(tilt))
        else:
            scale(row, np.float32(factor))
