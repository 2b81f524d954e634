"""Matched filter of frames at the positions of a plane that a map takes to their pixels.

The stamp is made anew for every position, which is exact for any map and several times slower than
the separable filter of the module ``matched_filter``; all frames of one map share it.
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import Offset, REORDERED_FINITE
from track_before_detect.kernels.psf.measurement import map_position
from track_before_detect.kernels.psf.psf_profiles import fill_profiles
from track_before_detect.kernels.scores.score_rows import score_row

_U = Offset


@numba.njit(**REORDERED_FINITE)
def _fill_stamp(stamp, rows, columns):
    """Fill ``stamp`` (K, K) from its profiles (C, K); return its squared norm."""
    total = 0.0
    for i in range(stamp.shape[0]):
        for k in range(stamp.shape[1]):
            value = 0.0
            for c in range(rows.shape[0]):
                value += rows[c, i] * columns[c, k]
            stamp[i, k] = value
            total += value * value
    return total


@numba.njit(**REORDERED_FINITE)
def _add_pixel(out, flat, start, factor):
    for n in range(out.size):
        out[n] += factor * flat[start + _U(n)]


@numba.njit(**REORDERED_FINITE)
def _product(out, stamp, flat, width, y_0, x_0, first_y, last_y, first_x, last_x):
    """Write the sum of the stamp's part inside times the pixels of each frame, (N,)."""
    out[:] = 0
    for i in range(first_y, last_y):
        start = ((y_0 + i) * width + x_0) * out.size
        for k in range(first_x, last_x):
            _add_pixel(out, flat, _U(start + k * out.size), stamp[i, k])


@numba.njit(**REORDERED_FINITE)
def scores_of_frames(out, which, real, imaginary, squared_weights, optics, matrix, step_px, model,
                     first_row, last_row):
    """Write what a position adds to the value of a path, of amplitudes that may fluctuate.

    out : float32 (T, Y, X), for positions ``step_px`` apart on the plane
    which : int64 (N,), the frames of this map
    real, imaginary : float32 (H, W, N), their pixels times one over the noise of each, masked ones
        zero; the imaginary part of no rows where frames are real
    squared_weights : float32 (H, W, N), one over the variance of each pixel, zero where masked;
        of no rows where it is one
    matrix : float64 (3, 3), takes the plane to the frames
    model : as for ``score_row``
    """
    height, width, n_frames = real.shape
    flat, flat_imaginary = real.reshape(real.size), imaginary.reshape(imaginary.size)
    flat_weights = squared_weights.reshape(squared_weights.size)
    n_taps = 2 * optics.half + 1
    ones = np.ones(1)
    rows = np.empty((optics.coefficients.shape[0], n_taps))
    columns = np.empty((optics.coefficients.shape[0], n_taps))
    unused = np.empty((optics.coefficients.shape[0], n_taps))
    stamp = np.empty((n_taps, n_taps), np.float32)
    slope = np.empty((2, 2))
    h = np.zeros((2, n_frames), np.float32)
    left = np.empty(n_frames, np.float32)
    # What a row of positions sees, and the share that is left of the stamps.
    seen = np.zeros((2, n_frames, out.shape[2]), np.float32)
    shares = np.empty((n_frames, out.shape[2]), np.float32)
    for row in range(first_row, last_row):
        for column in range(out.shape[2]):
            shares[:, column] = 0
            x, y = map_position(matrix, column * step_px, row * step_px, slope)
            x_0 = int(math.floor(x + 0.5)) - optics.half
            y_0 = int(math.floor(y + 0.5)) - optics.half
            first_y, last_y = max(0, -y_0), min(n_taps, height - y_0)
            first_x, last_x = max(0, -x_0), min(n_taps, width - x_0)
            if first_y >= last_y or first_x >= last_x:
                continue
            fill_profiles(optics, y, 0.0, 0, y_0, ones, rows, unused)
            fill_profiles(optics, x, 0.0, 1, x_0, ones, columns, unused)
            whole = _fill_stamp(stamp, rows, columns)
            _product(h[0], stamp, flat, width, y_0, x_0, first_y, last_y, first_x, last_x)
            if imaginary.shape[0] > 0:
                _product(h[1], stamp, flat_imaginary, width, y_0, x_0, first_y, last_y, first_x,
                         last_x)
            stamp *= stamp
            if squared_weights.shape[0] > 0:
                _product(left, stamp, flat_weights, width, y_0, x_0, first_y, last_y, first_x,
                         last_x)
            else:
                left[:] = stamp[first_y:last_y, first_x:last_x].sum()
            share, scale = 1 / whole, 1 / math.sqrt(whole)
            for n in range(n_frames):
                shares[n, column] = share * left[n]
                for part in range(2):
                    seen[part, n, column] = scale * h[part, n]
        for n in range(n_frames):
            out[which[n], row] = seen[0, n]
            score_row(out[which[n], row], seen[1, n] if imaginary.shape[0] > 0 else seen[1, n, :0],
                      shares[n], False, model, 1.0, 0.0)
