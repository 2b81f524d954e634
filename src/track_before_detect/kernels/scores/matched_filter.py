"""Matched filter of a PSF, a sum of separable components, on a grid finer than the pixels.

Layout of every array
---------------------
frame : float32 (H, W); no NaN, masked pixels are zero.
weights : float32 (H, W), multiplies the frame; of no rows where it is one.
taps : float32 (C, 2, S, K)
    Profile in y and in x of each of the C components for each of the S positions within a pixel,
    K odd, middle entry on the pixel itself.
level : float32 (S, S)
    Multiplies the stamp of each position within a pixel, y and x.
scale_y, scale_x : float32 (Y,), (X,)
    Multiply the rows and columns of the result.
out : float32 (Y, X), Y = S (H - 1) + 1, X = S (W - 1) + 1.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FUSED
from track_before_detect.kernels.scores.score_rows import multiply, score_row


@numba.njit(**FUSED)
def _add_scaled(out, source, factor):
    for x in range(out.size):
        out[x] += factor * source[x]


@numba.njit(**FUSED)
def _add_weighted(out, source, weights, factor):
    for x in range(out.size):
        out[x] += factor * weights[x] * source[x]


@numba.njit(**FUSED)
def _spread(out, source, first, stride, factor):
    for x in range(source.size):
        out[first + stride * x] = factor * source[x]


@numba.njit(**FUSED)
def _filter_row(out, y, frame, weights, taps, level, scale_y, scale_x, padded, part):
    """Write row ``y`` of the correlation; ``padded`` and ``part`` are room to work in."""
    n_components, _, n_sub, n_taps = taps.shape
    half = n_taps // 2
    height, width = frame.shape
    centre, phase_y = y // n_sub, y % n_sub
    inside = padded[half:half + width]
    for c in range(n_components):
        padded[:] = 0
        for k in range(max(0, half - centre), min(n_taps, height + half - centre)):
            row = centre + k - half
            factor = taps[c, 0, phase_y, k] * scale_y[y]
            if weights.shape[0] > 0:
                _add_weighted(inside, frame[row], weights[row], factor)
            else:
                _add_scaled(inside, frame[row], factor)
        for phase in range(n_sub):
            if c == 0:
                part[phase] = 0
            for k in range(n_taps):
                _add_scaled(part[phase], padded[k:k + width], taps[c, 1, phase, k])
    for phase in range(n_sub):
        _spread(out, part[phase, :width if phase == 0 else width - 1], phase, n_sub,
                level[phase_y, phase])
    multiply(out, scale_x)


@numba.njit(**FUSED)
def filter_frame(out, frame, weights, taps, level, scale_y, scale_x, first_row, last_row):
    """Write rows ``first_row`` to ``last_row`` of the correlation of ``frame`` with the PSF."""
    width = frame.shape[1]
    padded = np.empty(width + taps.shape[3] - 1, np.float32)
    part = np.empty((taps.shape[2], width), np.float32)
    for y in range(first_row, last_row):
        _filter_row(out[y], y, frame, weights, taps, level, scale_y, scale_x, padded, part)


@numba.njit(**FUSED)
def scores_of_frame(out, real, imaginary, weights, shares, uneven, taps, level, scale_y, scale_x,
                    model, factor, tilt, rows, first_row, last_row):
    """Write what a position adds to the value of a path, in those ``rows`` (Y,) that are true.

    ``shares`` (Y, X) is what weights and border leave of the squared norm of the PSF; of no rows
    where the scales make up for it. ``imaginary`` has no rows where frames are real. The rest is
    that of ``score_row``.
    """
    width = real.shape[1]
    padded = np.empty(width + taps.shape[3] - 1, np.float32)
    part = np.empty((taps.shape[2], width), np.float32)
    other = np.empty(out.shape[1] if imaginary.shape[0] > 0 else 0, np.float32)
    whole = np.empty(0, np.float32)
    for y in range(first_row, last_row):
        if not rows[y]:
            continue
        _filter_row(out[y], y, real, weights, taps, level, scale_y, scale_x, padded, part)
        if imaginary.shape[0] > 0:
            _filter_row(other, y, imaginary, weights, taps, level, scale_y, scale_x, padded, part)
        share = shares[y] if shares.shape[0] > 0 else whole
        score_row(out[y], other, share, uneven, model, factor, tilt)
