"""A picture as the matched filter of a target sees it, whose PSF is a product over both axes.

Layout of every array
---------------------
image, out : real (H, W), NaN where masked
profile : of the image's kind, odd (N,)
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import REORDERED_UNCHECKED


@numba.njit(**REORDERED_UNCHECKED)
def matched_statistic(image, profile, out):
    """Write what the filter says, of unit variance where noise is white; NaN where masked."""
    height, width = image.shape
    reach = profile.size // 2
    kind = image.dtype.type
    squares = profile * profile
    known = np.isfinite(image)
    values = np.where(known, image, kind(0))
    columns = np.zeros((2, width + 2 * reach), image.dtype)
    inner = columns[:, reach:reach + width]
    signal, power = np.empty(width, image.dtype), np.empty(width, image.dtype)
    for row in range(height):
        inner[:] = kind(0)
        for k in range(profile.size):
            source = row + k - reach
            if 0 <= source < height:
                _add(values[source], profile[k], inner[0])
                _add(known[source], squares[k], inner[1])
        signal[:] = kind(0)
        power[:] = kind(0)
        for k in range(profile.size):
            _add(columns[0, k:k + width], profile[k], signal)
            _add(columns[1, k:k + width], squares[k], power)
        for i in range(width):
            # A known pixel has a share in its own power.
            out[row, i] = signal[i] / math.sqrt(power[i]) if known[row, i] else np.nan


@numba.njit(**REORDERED_UNCHECKED)
def _add(row, weight, total):
    for i in range(total.size):
        total[i] += weight * row[i]
