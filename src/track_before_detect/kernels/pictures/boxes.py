"""Sums over the square around each pixel, by running sums in double precision.

Layout of every array
---------------------
image, out : real (H, W)
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT


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
        columns[:reach] = inner[0]
        columns[reach + width:] = inner[width - 1]
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
    columns = np.zeros((4, width + 2 * (outer // 2)))
    for i in range(min(outer // 2, height)):
        _add_known(image[i], 1.0, columns[2:], outer // 2)
    for i in range(min(inner // 2, height)):
        _add_known(image[i], 1.0, columns[:2], outer // 2)
    for row in range(height):
        for first, side in ((0, inner), (2, outer)):
            reach = side // 2
            if row + reach < height:
                _add_known(image[row + reach], 1.0, columns[first:first + 2], outer // 2)
            if row > reach:
                _add_known(image[row - reach - 1], -1.0, columns[first:first + 2], outer // 2)
        _ring_row(columns, inner, outer, least, out[row])


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
def _ring_row(columns, inner, outer, least, out):
    beside = outer // 2 - inner // 2
    power = count = power_inside = count_inside = 0.0
    for i in range(outer - 1):
        power += columns[2, i]
        count += columns[3, i]
    for i in range(beside, beside + inner - 1):
        power_inside += columns[0, i]
        count_inside += columns[1, i]
    for i in range(out.size):
        power += columns[2, i + outer - 1]
        count += columns[3, i + outer - 1]
        power_inside += columns[0, i + beside + inner - 1]
        count_inside += columns[1, i + beside + inner - 1]
        # The running sums may end a rounding error below 0.
        mean = max(power - power_inside, 0.0) / max(count - count_inside, 1.0)
        out[i] = max(math.sqrt(mean), least)
        power -= columns[2, i]
        count -= columns[3, i]
        power_inside -= columns[0, i + beside]
        count_inside -= columns[1, i + beside]


@numba.njit(**EXACT)
def _add(row, weight, total):
    for i in range(row.size):
        total[i] += weight * row[i]


@numba.njit(**EXACT)
def _add_known(row, weight, columns, start):
    """Add squares and number of the pixels of a row that are known, from column ``start`` on."""
    for i in range(row.size):
        known = abs(row[i]) < np.inf
        value = row[i] if known else 0.0
        columns[0, start + i] += weight * (float(value) * float(value))
        columns[1, start + i] += weight if known else 0.0
