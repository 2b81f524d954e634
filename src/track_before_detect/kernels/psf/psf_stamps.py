"""Stamps: the unit-norm picture of a target in each frame, at positions between the pixels.

Layout of every array
---------------------
optics : Optics, see the module ``psf_profiles``
positions : float64 (T, 2), column x and row y in pixels
stamps : float64 (T, K, K), K = 2 half + 1, rows are y
origins : int64 (T, 2), pixel (x, y) of stamps[t, 0, 0]; may lie outside the frame. Halfway between
    two pixels a stamp is centred on the first, as the matched filter on its grid is.
frames : float32 or complex64 (T, H, W), in units of the noise of each pixel, masked pixels zero
weights : float32 (T, H, W), one over the noise of each pixel, zero where masked; of one frame
    where it is the same in all, of no frames where it is one everywhere
norms : float64 (T,), what weights and border leave of the norm of the whole stamp
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.amplitude_codes import COMPLEX
from track_before_detect.kernels.compile_flags import EXACT, ZERO
from track_before_detect.kernels.psf.psf_profiles import (
    fill_profiles,
    inner_product,
    product_norm,
    smear_of,
)

# A target that shows less than this share of its energy, weighed against that of a whole one at a
# weight of one, counts as hidden: its position would be guessed from the outermost pixels
# (docs/constants/solvers.md).
LEAST_SHARE = 1e-3


@numba.njit(**EXACT)
def _profiles(optics):
    """Return room for profiles and their slopes (4, N, K): rows, columns, and those of each."""
    return np.empty((4, optics.coefficients.shape[0] * optics.nodes.size, 2 * optics.half + 1))


@numba.njit(**EXACT)
def _place(optics, positions, t, ones, profiles):
    """Fill the profiles of frame t; return the first pixel of the stamp."""
    smear_x, smear_y = smear_of(optics, positions, t)
    x_0 = int(math.ceil(positions[t, 0] - 0.5)) - optics.half
    y_0 = int(math.ceil(positions[t, 1] - 0.5)) - optics.half
    fill_profiles(optics, positions[t, 1], smear_y, ZERO, y_0, optics.shares, profiles[0],
                  profiles[2])
    fill_profiles(optics, positions[t, 0], smear_x, ZERO + 1, x_0, ones, profiles[1],
                  profiles[3])
    return x_0, y_0


@numba.njit(**EXACT)
def render(optics, positions, height, width, weights, stamps, origins, norms):
    """Fill ``stamps``, ``origins`` and ``norms``: cut at the border, weighed, then of unit norm.

    A stamp of which nearly nothing is left (LEAST_SHARE) is all zero, as is its norm.
    """
    ones, profiles = np.ones(optics.nodes.size), _profiles(optics)
    rows, columns = profiles[0], profiles[1]
    n_parts, size = rows.shape
    weighted = weights.shape[0] > 0
    for t in range(positions.shape[0]):
        x_0, y_0 = _place(optics, positions, t, ones, profiles)
        origins[t, 0] = x_0
        origins[t, 1] = y_0
        stamps[t] = 0.0
        total = 0.0
        for i in range(max(0, -y_0), min(size, height - y_0)):
            for k in range(max(0, -x_0), min(size, width - x_0)):
                value = 0.0
                for c in range(n_parts):
                    value += rows[c, i] * columns[c, k]
                if weighted:
                    value *= weights[t if weights.shape[0] > 1 else 0, y_0 + i, x_0 + k]
                stamps[t, i, k] = value
                total += value * value
        share = total / product_norm(rows, columns, ZERO, size, ZERO, size)
        norms[t] = math.sqrt(share) if share > LEAST_SHARE else 0.0
        factor = 1.0 / math.sqrt(total) if share > LEAST_SHARE else 0.0
        for i in range(size):
            for k in range(size):
                stamps[t, i, k] *= factor


@numba.njit(**EXACT)
def correlate(stamps, origins, frames, out):
    """Write the inner product of each stamp with its frame to out[t]."""
    n_frames, size, _ = stamps.shape
    height, width = frames.shape[1:]
    for t in range(n_frames):
        total = 0.0 * frames[t, 0, 0]
        for i in range(max(0, -origins[t, 1]), min(size, height - origins[t, 1])):
            for k in range(max(0, -origins[t, 0]), min(size, width - origins[t, 0])):
                total += stamps[t, i, k] * frames[t, origins[t, 1] + i, origins[t, 0] + k]
        out[t] = total


@numba.njit(**EXACT)
def accumulate(frames, stamps, origins, amplitudes):
    """Add ``amplitudes[t]`` times each stamp to its frame."""
    n_frames, size, _ = stamps.shape
    height, width = frames.shape[1:]
    for t in range(n_frames):
        if amplitudes[t] == 0.0:
            continue
        for i in range(max(0, -origins[t, 1]), min(size, height - origins[t, 1])):
            for k in range(max(0, -origins[t, 0]), min(size, width - origins[t, 0])):
                frames[t, origins[t, 1] + i, origins[t, 0] + k] += (
                    amplitudes[t] * stamps[t, i, k])


@numba.njit(**EXACT)
def overlap(stamps_a, origins_a, stamps_b, origins_b, out):
    """Write the inner product of two stamps, frame by frame, to out[t]."""
    n_frames, size, _ = stamps_a.shape
    for t in range(n_frames):
        shift_x = origins_b[t, 0] - origins_a[t, 0]
        shift_y = origins_b[t, 1] - origins_a[t, 1]
        total = 0.0
        for i in range(max(0, shift_y), min(size, size + shift_y)):
            for k in range(max(0, shift_x), min(size, size + shift_x)):
                total += stamps_a[t, i, k] * stamps_b[t, i - shift_y, k - shift_x]
        out[t] = total


@numba.njit(**EXACT)
def statistic_and_slope(optics, positions, frames, weights, model, out, norms):
    """Write statistic and its slope in x and y to out[t] = (h, dh/dx, dh/dy).

    ``norms`` is as in ``render`` where there are weights, otherwise one, or zero where nothing is
    seen. Of complex frames these are |h| and its slope. The slope leaves out that the smear
    changes with the path.
    """
    height, width = frames.shape[1:]
    ones, profiles = np.ones(optics.nodes.size), _profiles(optics)
    # Unpacked like a tuple they would be of another type than elsewhere.
    rows, columns, row_slopes, column_slopes = (
        profiles[0], profiles[1], profiles[2], profiles[3])
    n_parts, size = rows.shape
    weighted = weights.shape[0] > 0
    for t in range(positions.shape[0]):
        x_0, y_0 = _place(optics, positions, t, ones, profiles)
        first_row, last_row = max(0, -y_0), min(size, height - y_0)
        first, last = max(0, -x_0), min(size, width - x_0)
        h = 0.0 * frames[0, 0, 0]
        slope_x = 0.0 * frames[0, 0, 0]
        slope_y = 0.0 * frames[0, 0, 0]
        total = 0.0
        along_x = 0.0
        along_y = 0.0
        at = t if weights.shape[0] > 1 else 0
        for i in range(first_row, last_row):
            y = y_0 + i
            for c in range(n_parts):
                row_h = 0.0 * frames[0, 0, 0]
                row_slope = 0.0 * frames[0, 0, 0]
                if weighted:
                    for k in range(first, last):
                        pixel = frames[t, y, x_0 + k] * weights[at, y, x_0 + k]
                        row_h += columns[c, k] * pixel
                        row_slope += column_slopes[c, k] * pixel
                else:
                    for k in range(first, last):
                        row_h += columns[c, k] * frames[t, y, x_0 + k]
                        row_slope += column_slopes[c, k] * frames[t, y, x_0 + k]
                h += rows[c, i] * row_h
                slope_x += rows[c, i] * row_slope
                slope_y += row_slopes[c, i] * row_h
            if weighted:
                for k in range(first, last):
                    value = 0.0
                    change_x = 0.0
                    change_y = 0.0
                    for c in range(n_parts):
                        value += rows[c, i] * columns[c, k]
                        change_x += rows[c, i] * column_slopes[c, k]
                        change_y += row_slopes[c, i] * columns[c, k]
                    squared = weights[at, y, x_0 + k]**2
                    total += squared * value * value
                    along_x += squared * value * change_x
                    along_y += squared * value * change_y
        if not weighted:
            total = product_norm(rows, columns, first_row, last_row, first, last)
            along_x = inner_product(rows, columns, rows, column_slopes, first_row, last_row,
                                    first, last)
            along_y = inner_product(rows, columns, row_slopes, columns, first_row, last_row,
                                    first, last)
        if total > 0.0:
            # The norm changes as well: beside borders and masks, and of sharp PSFs everywhere.
            slope_x -= h * (along_x / total)
            slope_y -= h * (along_y / total)
        share = total / product_norm(rows, columns, ZERO, size, ZERO, size)
        norms[t] = 0.0
        if share > LEAST_SHARE:
            norms[t] = math.sqrt(share) if weighted else 1.0
        factor = 1.0 / math.sqrt(total) if share > LEAST_SHARE else 0.0
        if model >= COMPLEX:
            magnitude = math.sqrt(h.real**2 + h.imag**2)
            phase = np.conj(h) / magnitude if magnitude > 0.0 else 0.0 * h
            out[t, 0] = magnitude * factor
            out[t, 1] = (phase * slope_x).real * factor
            out[t, 2] = (phase * slope_y).real * factor
        else:
            out[t, 0] = h.real * factor
            out[t, 1] = slope_x.real * factor
            out[t, 2] = slope_y.real * factor
