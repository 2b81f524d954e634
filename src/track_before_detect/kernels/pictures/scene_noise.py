"""What noise depends on in a picture: its brightness, and its slopes.

Layout of every array
---------------------
frame, residual, out of ``noise_at`` : real (H, W), NaN where masked; their difference is the
    background
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT


@numba.njit(**EXACT)
def terms_at(frame, residual, first, step, out):
    """Write squared residual, brightness and squared slope of every ``step``-th pixel to out[n].

    The first is the pixel ``first`` in the order of rows; NaN where it is masked.
    """
    width = frame.shape[1]
    for n in range(len(out)):
        row, column = divmod(first + n * step, width)
        out[n, 0] = residual[row, column] * residual[row, column]
        out[n, 1] = frame[row, column] - residual[row, column]
        out[n, 2] = _squared_slope(frame, residual, row, column)


@numba.njit(**EXACT)
def noise_at(frame, residual, dark, factors, least, out):
    """Write the deviation of the noise at each pixel, NaN where it is masked.

    The variance is factors @ (1, brightness over that of ``dark``, squared slope), and at least
    ``least``.
    """
    height, width = frame.shape
    for row in range(height):
        for column in range(width):
            brightness = frame[row, column] - residual[row, column] - dark
            slope = _squared_slope(frame, residual, row, column)
            variance = factors[0] + factors[1] * max(brightness, 0.0) + factors[2] * slope
            out[row, column] = math.sqrt(max(variance, least)) if brightness == brightness \
                else np.nan


@numba.njit(**EXACT)
def _squared_slope(frame, residual, row, column):
    """Return the squared slope of the background; what is masked or beyond has none."""
    height, width = frame.shape
    middle = frame[row, column] - residual[row, column]
    total = 0.0
    for across in range(2):
        rise, pixels = 0.0, 0
        for sign in (-1, 1):
            i, k = row + sign * (1 - across), column + sign * across
            if 0 <= i < height and 0 <= k < width:
                beside = frame[i, k] - residual[i, k]
                if abs(beside) < np.inf:
                    rise += sign * (beside - middle)
                    pixels += 1
        if pixels:
            total += (rise / pixels)**2
    return total
