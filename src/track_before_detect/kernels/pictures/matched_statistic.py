"""A picture as the matched filter of a target sees it, whose PSF is a product over both axes.

Layout of every array
---------------------
image, out : real (H, W), NaN where masked
profile : of the image's kind, odd (N,)
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, REORDERED_UNCHECKED


@numba.njit(**REORDERED_UNCHECKED)
def matched_statistic(image, profile, out):
    """Write what the filter says, of unit variance where noise is white; NaN where masked."""
    height, width = image.shape
    reach = profile.size // 2
    values, known = np.empty_like(image), np.empty_like(image)
    for row in range(height):
        _split(image[row], values[row], known[row])
    # Of each column, and beyond the border: the sums over the rows of the filter.
    signals, powers = np.zeros(width + 2 * reach, image.dtype), np.zeros(
        width + 2 * reach, image.dtype)
    signal, power = np.empty(width, image.dtype), np.empty(width, image.dtype)
    for row in range(height):
        first, end = max(row - reach, 0), min(row + reach + 1, height)
        _filter(values[first], profile[first - row + reach], True, signals[reach:reach + width])
        _filter(known[first], profile[first - row + reach]**2, True, powers[reach:reach + width])
        for source in range(first + 1, end):
            weight = profile[source - row + reach]
            _filter(values[source], weight, False, signals[reach:reach + width])
            _filter(known[source], weight**2, False, powers[reach:reach + width])
        for k in range(profile.size):
            _filter(signals[k:k + width], profile[k], k == 0, signal)
            _filter(powers[k:k + width], profile[k]**2, k == 0, power)
        for i in range(width):
            # A known pixel has a share in its own power.
            out[row, i] = signal[i] / math.sqrt(power[i]) if known[row, i] > 0 else np.nan


@numba.njit(**EXACT)
def _split(row, values, known):
    """Write the pixels of a row, 0 where masked, and 1 where they are known."""
    for i in range(row.size):
        is_known = abs(row[i]) < np.inf
        values[i] = row[i] if is_known else 0.0
        known[i] = 1.0 if is_known else 0.0


@numba.njit(**REORDERED_UNCHECKED)
def _filter(row, weight, is_first, total):
    """Add a row to the total, or begin with it."""
    if is_first:
        for i in range(total.size):
            total[i] = weight * row[i]
    else:
        for i in range(total.size):
            total[i] += weight * row[i]
