"""Merit function of first-order dynamic programming over whole pixels (Fu et al. 2022, Eq. 2).

Layout of every array
---------------------
frames : float32 (T, H, W)
    Observations.
merit : float32 (K, H, W)
    Merit function; frame t is in plane t % K.

The largest value of a square of pixels is the largest of its rows of the largest of its columns,
so a step costs about 2 log2(2 v_max + 1) comparisons a pixel in place of (2 v_max + 1)^2. The
loops over x are small functions of their own, see the module ``rows``.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FUSED, Offset
from track_before_detect.kernels.rows import ABSENT, copy_row, larger_of_two, largest_of_three

_U = Offset


@numba.njit(**FUSED)
def _raise_to_two(out, o, source, a, b, n):
    for x in range(_U(n)):
        largest = source[a + x] if source[a + x] > source[b + x] else source[b + x]
        out[o + x] = out[o + x] if out[o + x] > largest else largest


@numba.njit(**FUSED)
def _add_larger(out, o, frames, a, source, b, later, n):
    for x in range(_U(n)):
        here, there = source[b + x], source[b + later + x]
        out[o + x] = frames[a + x] + (here if here > there else there)


@numba.njit(**FUSED)
def accumulate(merit, frames, start, n_steps, step, v_max, first_row, last_row):
    """Write merit[t] = frames[t] + max over |v| <= v_max of merit[t - step, p - v].

    For t = start, start + step, ... in ``n_steps`` steps; ``step`` is 1 or -1. Rows
    ``first_row`` to ``last_row`` of the last of these frames are written, and of the others as
    many more as they depend on, so that bands of rows can be worked on apart from each other:
    where two bands write the same number it has the same value. The planes of these frames and of
    the one before have to be different ones.
    """
    n_planes, n_y, n_x = merit.shape
    flat = merit.reshape(merit.size)
    flat_frames = frames.reshape(frames.size)
    width = 2 * v_max + 1
    # Three rows, apart so that none is read and written in one loop: the largest of each column
    # with v_max absent pixels on either side, and two that take turns with the largest of wider
    # and wider windows.
    stride = n_x + 2 * v_max
    rows = np.full(3 * stride, ABSENT)
    for k in range(n_steps):
        t = start + k * step
        more = v_max * (n_steps - 1 - k)
        for y in range(max(0, first_row - more), min(n_y, last_row + more)):
            before = (t - step) % n_planes * n_y
            # A row beyond the border counts as the nearest one inside, which is in the window.
            here = _U((before + y) * n_x)
            if v_max == 0:
                copy_row(rows, _U(0), flat, here, n_x)
            else:
                largest_of_three(
                    rows, _U(v_max), flat, _U((before + max(y - 1, 0)) * n_x), here,
                    _U((before + min(y + 1, n_y - 1)) * n_x), n_x)
            for away in range(2, v_max + 1):
                _raise_to_two(rows, _U(v_max), flat, _U((before + max(y - away, 0)) * n_x),
                              _U((before + min(y + away, n_y - 1)) * n_x), n_x)
            covered, source, target = 1, 0, stride
            while 2 * covered <= width:
                larger_of_two(rows, _U(target), rows, _U(source), _U(source + covered),
                              n_x + 2 * v_max - 2 * covered + 1)
                covered *= 2
                source, target = target, 3 * stride - target
            _add_larger(flat, _U((t % n_planes * n_y + y) * n_x), flat_frames,
                        _U((t * n_y + y) * n_x), rows, _U(source), _U(width - covered), n_x)
