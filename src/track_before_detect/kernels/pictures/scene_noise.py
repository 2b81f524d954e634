"""What noise depends on in a picture: its brightness, and its slopes.

Layout of every array
---------------------
frame, residual, out of ``noise_at`` : real (H, W), NaN where masked; their difference is the
    background
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, UNCHECKED


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
    # The background of three rows, unknown beyond the border.
    rows = np.full((3, width + 2), np.nan, frame.dtype)
    for row in range(-1, height):
        below = rows[(row + 1) % 3]
        if row + 1 < height:
            _subtract(frame[row + 1], residual[row + 1], below[1:-1])
        else:
            below[:] = np.nan
        if row >= 0:
            _noise_of_row(rows[(row - 1) % 3], rows[row % 3], below, dark, factors[0],
                          factors[1], factors[2], least, out[row])


@numba.njit(**EXACT)
def _subtract(frame, residual, out):
    for i in range(out.size):
        out[i] = frame[i] - residual[i]


@numba.njit(**UNCHECKED)
def _noise_of_row(above, here, below, dark, even, by_brightness, by_slope, least, out):
    for i in range(out.size):
        middle = here[i + 1]
        brightness = middle - dark
        slope = (_squared_rise(above[i + 1], middle, below[i + 1])
                 + _squared_rise(here[i], middle, here[i + 2]))
        variance = even + by_brightness * max(brightness, 0.0) + by_slope * slope
        deviation = math.sqrt(max(variance, least))
        out[i] = deviation if brightness == brightness else np.nan


@numba.njit(**EXACT)
def _squared_slope(frame, residual, row, column):
    """Return the squared slope of the background; what is masked or beyond has none."""
    middle = _background(frame, residual, row, column)
    return (_squared_rise(_background(frame, residual, row - 1, column), middle,
                          _background(frame, residual, row + 1, column))
            + _squared_rise(_background(frame, residual, row, column - 1), middle,
                            _background(frame, residual, row, column + 1)))


@numba.njit(**EXACT)
def _background(frame, residual, row, column):
    """Return the background of a pixel, NaN beyond the border."""
    if 0 <= row < frame.shape[0] and 0 <= column < frame.shape[1]:
        return frame[row, column] - residual[row, column]
    return frame.dtype.type(np.nan)


@numba.njit(**UNCHECKED)
def _squared_rise(before, middle, after):
    """Return the squared mean rise from a pixel to those beside it that are known, 0 of none."""
    down = middle - before if abs(before) < np.inf else middle - middle
    up = after - middle if abs(after) < np.inf else middle - middle
    known = (1.0 if abs(before) < np.inf else 0.0) + (1.0 if abs(after) < np.inf else 0.0)
    rise = (float(down) + float(up)) / max(known, 1.0)
    return rise * rise
