"""The median of each pixel over time, by a sorting network that many pixels go through at once.

The network is Batcher's merge exchange (Knuth, The Art of Computer Programming 3, 5.2.2M): which
values are compared does not depend on them, so that whole rows of pixels are.

Layout of every array
---------------------
frames : real (T, N), not finite where masked
out : real (N,), NaN where fewer than ``least`` values are finite
values : of the frames' kind (T, block), one place of a pixel after the other
count : int (block,)
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, NUMBERS

# Pixels that go through the network at once: those of 16 frames stay in the first cache.
BLOCK = 128


@numba.njit(**EXACT)
def median_over_time(frames, least, out):
    """Write the median of the finite values of each pixel."""
    n_frames, n_pixels = frames.shape
    values = np.empty((n_frames, BLOCK), frames.dtype)
    for first in range(0, n_pixels, BLOCK):
        size = min(BLOCK, n_pixels - first)
        count = np.zeros(BLOCK, np.int64)
        for t in range(n_frames):
            _take(frames[t, first:first + size], values[t], count)
        _sort(values, size)
        for i in range(size):
            known = count[i]
            if known < least:
                out[first + i] = np.nan
            else:
                low, high = values[(known - 1) // 2, i], values[known // 2, i]
                out[first + i] = frames.dtype.type(0.5) * (low + high)


@numba.njit(**EXACT)
def _take(row, values, count):
    """Copy a row of pixels, infinity for what is not finite, and count what is."""
    for i in range(row.size):
        known = abs(row[i]) < np.inf
        values[i] = row[i] if known else np.inf
        count[i] += known


@numba.njit(**EXACT)
def _sort(values, size):
    """Sort over the first axis."""
    n_frames = values.shape[0]
    highest = 1
    while 2 * highest < n_frames:
        highest *= 2
    part = highest
    while part > 0:
        span, rest, distance = highest, 0, part
        while distance > 0:
            for t in range(n_frames - distance):
                if t & part == rest:
                    _exchange(values[t], values[t + distance], size)
            distance, span, rest = span - part, span // 2, part
        part //= 2


@numba.njit(**NUMBERS)
def _exchange(low, high, size):
    """Bring each pair of values in order."""
    for i in range(size):
        a, b = low[i], high[i]
        low[i] = a if a < b else b
        high[i] = b if a < b else a
