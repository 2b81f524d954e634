"""Sums over the square around each pixel, by running sums in double precision.

Layout of every array
---------------------
image, out : real (H, W)
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, UNCHECKED


@numba.njit(**EXACT)
def box_mean(image, side, out):
    """Write the mean over the square of an odd side around each pixel.

    The image is finite; beyond the border it is continued by its last pixel.
    """
    height, width = image.shape
    reach = side // 2
    columns = np.zeros(width + 2 * reach)
    inner = columns[reach:reach + width]
    for i in range(-reach, reach + 1):
        _add(image[min(max(i, 0), height - 1)], 1.0, inner)
    for row in range(height):
        for i in range(reach):
            columns[i] = inner[0]
            columns[reach + width + i] = inner[width - 1]
        _running_mean(columns, side, 1.0 / (side * side), out[row])
        _add(image[min(row + reach + 1, height - 1)], 1.0, inner)
        _add(image[max(row - reach, 0)], -1.0, inner)


@numba.njit(**EXACT)
def ring_level(image, inner, outer, least, out):
    """Write the root mean square in the ring around each pixel, or ``least`` where it is less.

    The ring is between the squares with these odd sides; NaN, and what is beyond the border, is
    left out.
    """
    height, width = image.shape
    # Squares and numbers of known pixels of each column, in the inner and in the outer square.
    far, near = outer // 2, inner // 2
    columns, sums = np.zeros((4, width + 2 * far)), np.empty((2, width))
    for i in range(min(far, height)):
        _add_known(image[i], 1.0, columns[2], columns[3], far)
    for i in range(min(near, height)):
        _add_known(image[i], 1.0, columns[0], columns[1], far)
    for row in range(height):
        if row + far < height:
            _add_known(image[row + far], 1.0, columns[2], columns[3], far)
        if row > far:
            _add_known(image[row - far - 1], -1.0, columns[2], columns[3], far)
        if row + near < height:
            _add_known(image[row + near], 1.0, columns[0], columns[1], far)
        if row > near:
            _add_known(image[row - near - 1], -1.0, columns[0], columns[1], far)
        for of in range(2):
            _running_ring(columns[of], columns[2 + of], near, far, sums[of])
        _write_levels(sums[0], sums[1], least, out[row])


@numba.njit(**EXACT)
def _running_mean(columns, side, share, out):
    total = 0.0
    for i in range(side - 1):
        total += columns[i]
    for i in range(out.size):
        total += columns[i + side - 1]
        out[i] = total * share
        total -= columns[i]


@numba.njit(**EXACT)
def _running_ring(inner, outer, near, far, out):
    """Write the sums over the outer columns around each less those over the inner ones."""
    total = 0.0
    for i in range(2 * far):
        total += outer[i]
    for i in range(far - near, far + near):
        total -= inner[i]
    for i in range(out.size):
        total += outer[i + 2 * far] - inner[i + far + near]
        out[i] = total
        total -= outer[i] - inner[i + far - near]


@numba.njit(**UNCHECKED)
def _write_levels(power, count, least, out):
    for i in range(out.size):
        # The running sums may end a rounding error below 0.
        out[i] = max(math.sqrt(max(power[i], 0.0) / max(count[i], 1.0)), least)


@numba.njit(**EXACT)
def _add(row, weight, total):
    for i in range(row.size):
        total[i] += weight * row[i]


@numba.njit(**EXACT)
def _add_known(row, weight, squares, counts, start):
    """Add squares and number of the pixels of a row that are known, from column ``start`` on."""
    for i in range(row.size):
        known = abs(row[i]) < np.inf
        value = float(row[i]) if known else 0.0
        squares[start + i] += weight * (value * value)
        counts[start + i] += weight if known else 0.0
