"""Matched filter of a separable PSF on a grid finer than the pixels.

Layout of every array
---------------------
frame : float32 (H, W); no NaN, masked pixels are zero.
taps : float32 (S, K)
    Unit-norm profile for each of the S positions within a pixel, K odd, middle entry on the
    pixel itself.
scale_y, scale_x : float32 (Y,), (X,)
    One over the norm of the profile that is left inside the frame.
out : float32 (Y, X), Y = S (H - 1) + 1, X = S (W - 1) + 1.
"""

import numba
import numpy as np

_COMPILE = {'nogil': True, 'cache': True, 'fastmath': {'nnan', 'ninf', 'nsz', 'contract'}}


@numba.njit(**_COMPILE)
def _add_scaled(out, source, factor):
    for x in range(out.size):
        out[x] += factor * source[x]


@numba.njit(**_COMPILE)
def _spread(out, source, first, stride):
    for x in range(source.size):
        out[first + stride * x] = source[x]


@numba.njit(**_COMPILE)
def _times(out, factor):
    for x in range(out.size):
        out[x] *= factor[x]


@numba.njit(**_COMPILE)
def filter_frame(out, frame, taps, scale_y, scale_x, first_row, last_row):
    """Write rows ``first_row`` to ``last_row`` of the correlation of ``frame`` with the PSF."""
    n_sub, n_taps = taps.shape
    half = n_taps // 2
    height, width = frame.shape
    padded = np.zeros(width + 2 * half, np.float32)
    part = np.empty(width, np.float32)
    for y in range(first_row, last_row):
        centre, phase = y // n_sub, y % n_sub
        padded[:] = 0
        for k in range(n_taps):
            row = centre + k - half
            if 0 <= row < height:
                _add_scaled(padded[half:half + width], frame[row], taps[phase, k] * scale_y[y])
        for phase in range(n_sub):
            part[:] = 0
            for k in range(n_taps):
                _add_scaled(part, padded[k:k + width], taps[phase, k])
            _spread(out[y], part[:width if phase == 0 else width - 1], phase, n_sub)
        _times(out[y], scale_x)


@numba.njit(**_COMPILE)
def _square_positive(row):
    for x in range(row.size):
        value = row[x] if row[x] > 0 else np.float32(0)
        row[x] = value * value


@numba.njit(**_COMPILE)
def _square(row):
    for x in range(row.size):
        row[x] *= row[x]


@numba.njit(**_COMPILE)
def _scale(row, factor):
    for x in range(row.size):
        row[x] *= factor


@numba.njit(**_COMPILE)
def _over_norm(row, norm_squared):
    for x in range(row.size):
        weight = norm_squared[x]
        row[x] = row[x] / np.sqrt(weight) if weight > np.float32(1e-3) else np.float32(0)


@numba.njit(**_COMPILE)
def scores_of_frame(out, frame, norm_squared, taps, scale_y, scale_x, model, n_frames,
                    first_row, last_row):
    """Write what a position adds to the value of a path.

    That is max(h, 0)^2, h^2 or h / sqrt(n_frames) for the amplitude ``model`` 0, 1 or 2, with h
    the matched filter statistic. ``norm_squared`` (Y, X) is what masked pixels leave of the
    squared norm of the PSF, of no rows where nothing is masked.
    """
    filter_frame(out, frame, taps, scale_y, scale_x, first_row, last_row)
    for y in range(first_row, last_row):
        if norm_squared.shape[0] > 0:
            _over_norm(out[y], norm_squared[y])
        if model == 0:
            _square_positive(out[y])
        elif model == 1:
            _square(out[y])
        else:
            _scale(out[y], np.float32(1.0 / np.sqrt(n_frames)))
