"""Images between their pixels, by cubic convolution (Keys 1981, a = -1/2).

Layout of every array
---------------------
image : float32 (H, W); NaN where masked
x, y : float64 (N,), column and row in pixels
matrix : float64 (3, 3), see the module ``geometry``
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT


@numba.njit(**EXACT)
def _weights(fraction, weight, slope):
    """Fill the weights, and their derivative, of the pixels at -1, 0, 1 and 2."""
    f = fraction
    weight[0] = ((-0.5 * f + 1.0) * f - 0.5) * f
    weight[1] = (1.5 * f - 2.5) * f * f + 1.0
    weight[2] = ((-1.5 * f + 2.0) * f + 0.5) * f
    weight[3] = (0.5 * f - 0.5) * f * f
    slope[0] = (-1.5 * f + 2.0) * f - 0.5
    slope[1] = (4.5 * f - 5.0) * f
    slope[2] = (-4.5 * f + 4.0) * f + 0.5
    slope[3] = (1.5 * f - 1.0) * f


@numba.njit(**EXACT)
def sample_with_slope(image, x, y, out):
    """Write value and slope in x and y at each position to out[n] = (f, df/dx, df/dy).

    Beyond the border the image is continued by its last pixel.
    """
    height, width = image.shape
    weight_x, slope_x = np.empty(4), np.empty(4)
    weight_y, slope_y = np.empty(4), np.empty(4)
    for n in range(x.size):
        left, top = math.floor(x[n]), math.floor(y[n])
        _weights(x[n] - left, weight_x, slope_x)
        _weights(y[n] - top, weight_y, slope_y)
        value = along_x = along_y = 0.0
        for i in range(4):
            row = min(max(int(top) + i - 1, 0), height - 1)
            total = rise = 0.0
            for k in range(4):
                pixel = image[row, min(max(int(left) + k - 1, 0), width - 1)]
                total += weight_x[k] * pixel
                rise += slope_x[k] * pixel
            value += weight_y[i] * total
            along_x += weight_y[i] * rise
            along_y += slope_y[i] * total
        out[n, 0] = value
        out[n, 1] = along_x
        out[n, 2] = along_y


@numba.njit(**EXACT)
def warp(image, matrix, out):
    """Write to out[y, x] the image where ``matrix`` takes (x, y), NaN where that is outside.

    A pixel of weight 0 is not looked at, so that a NaN spreads no further than it must; the
    border is continued by its last pixel.
    """
    height, width = image.shape
    weight_x, weight_y, slope = np.empty(4), np.empty(4), np.empty(4)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            out[row, column] = np.nan
            depth = matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2]
            if not depth > 0:
                continue
            x = (matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2]) / depth
            y = (matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2]) / depth
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                continue
            left, top = math.floor(x), math.floor(y)
            _weights(x - left, weight_x, slope)
            _weights(y - top, weight_y, slope)
            value = 0.0
            for i in range(4):
                if weight_y[i] == 0.0:
                    continue
                source = min(max(int(top) + i - 1, 0), height - 1)
                total = 0.0
                for k in range(4):
                    if weight_x[k] != 0.0:
                        total += weight_x[k] * image[
                            source, min(max(int(left) + k - 1, 0), width - 1)]
                value += weight_y[i] * total
            out[row, column] = value


@numba.njit(**EXACT)
def nearest(image, matrix, out):
    """Write to out[y, x] the pixel nearest to where ``matrix`` takes (x, y).

    Beyond the border that is the last one; the first of all where the map leads nowhere.
    """
    height, width = image.shape
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            x, y = 0.0, 0.0
            depth = matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2]
            if depth > 0:
                x = (matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2]) / depth
                y = (matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2]) / depth
            out[row, column] = image[int(min(max(np.rint(y), 0.0), height - 1.0)),
                                     int(min(max(np.rint(x), 0.0), width - 1.0))]


@numba.njit(**EXACT)
def shift(image, x, y, out):
    """Write to out[row, column] the image at (column + x, row + y), as :func:`warp` does."""
    height, width = image.shape
    left, top = int(math.floor(x)), int(math.floor(y))
    weight_x, weight_y, slope = np.empty(4), np.empty(4), np.empty(4)
    _weights(x - left, weight_x, slope)
    _weights(y - top, weight_y, slope)
    first = min(max(int(math.ceil(-0.5 - x)), 0), out.shape[1])
    end = max(min(int(math.floor(width - 0.5 - x)) + 1, out.shape[1]), first)
    # Of the rows of the image, the last four interpolated along x.
    lines, held = np.empty((4, end - first)), np.full(4, -1)
    total = np.empty(end - first)
    for row in range(out.shape[0]):
        _fill(out[row], np.nan)
        if not -0.5 <= row + y <= height - 0.5:
            continue
        _fill(total, 0.0)
        for i in range(4):
            if weight_y[i] == 0.0:
                continue
            source = min(max(row + top + i - 1, 0), height - 1)
            line = lines[source % 4]
            if held[source % 4] != source:
                held[source % 4] = source
                _shift_row(image[source], first + left - 1, weight_x, line)
            _add(line, weight_y[i], total)
        for column in range(end - first):
            out[row, first + column] = total[column]


@numba.njit(**EXACT)
def _shift_row(row, start, weight, line):
    """Write to line[n] the row interpolated between its pixels from ``start + n`` on."""
    _fill(line, 0.0)
    for k in range(4):
        if weight[k] != 0.0:
            begin = start + k
            a = min(max(-begin, 0), line.size)
            b = min(max(row.size - begin, a), line.size)
            for n in range(a):
                line[n] += weight[k] * row[0]
            _add(row[begin + a:begin + b], weight[k], line[a:b])
            for n in range(b, line.size):
                line[n] += weight[k] * row[row.size - 1]


@numba.njit(**EXACT)
def _fill(row, value):
    for n in range(row.size):
        row[n] = value


@numba.njit(**EXACT)
def _add(values, weight, total):
    for n in range(total.size):
        total[n] += weight * values[n]
