"""Stamps: the unit-norm picture of a target in each frame, at positions between the pixels.

Layout of every array
---------------------
positions : float64 (T, 2), column x and row y in pixels
stamps : float64 (T, K, K), K = 2 half + 1, rows are y
origins : int64 (T, 2), pixel (x, y) of stamps[t, 0, 0]; may lie outside the frame
frames : float32 (T, H, W), masked pixels are zero
valid : bool (T, H, W), or of no frames where every pixel is valid
"""

import math

import numba
import numpy as np

_COMPILE = {'nogil': True, 'cache': True}


@numba.njit(**_COMPILE)
def render_gaussian(positions, sigma, half, height, width, valid, stamps, origins):
    """Fill ``stamps`` and ``origins``: cut at the border and the mask, then of unit norm.

    A stamp with no valid pixel is all zero.
    """
    n_frames = positions.shape[0]
    size = 2 * half + 1
    profile_x = np.empty(size)
    profile_y = np.empty(size)
    scale = -0.5 / (sigma * sigma)
    for t in range(n_frames):
        origins[t, 0] = int(math.floor(positions[t, 0] + 0.5)) - half
        origins[t, 1] = int(math.floor(positions[t, 1] + 0.5)) - half
        for k in range(size):
            x = origins[t, 0] + k
            y = origins[t, 1] + k
            profile_x[k] = math.exp(scale * (x - positions[t, 0])**2) if 0 <= x < width else 0.0
            profile_y[k] = math.exp(scale * (y - positions[t, 1])**2) if 0 <= y < height else 0.0
        total = 0.0
        for i in range(size):
            for k in range(size):
                value = profile_y[i] * profile_x[k]
                if valid.shape[0] > 0 and value > 0.0:
                    if not valid[t, origins[t, 1] + i, origins[t, 0] + k]:
                        value = 0.0
                stamps[t, i, k] = value
                total += value * value
        factor = 1.0 / math.sqrt(total) if total > 1e-6 else 0.0
        for i in range(size):
            for k in range(size):
                stamps[t, i, k] *= factor


@numba.njit(**_COMPILE)
def correlate(stamps, origins, frames, out):
    """Write the inner product of each stamp with its frame to out[t]."""
    n_frames, size, _ = stamps.shape
    height, width = frames.shape[1:]
    for t in range(n_frames):
        total = 0.0
        for i in range(max(0, -origins[t, 1]), min(size, height - origins[t, 1])):
            for k in range(max(0, -origins[t, 0]), min(size, width - origins[t, 0])):
                total += stamps[t, i, k] * frames[t, origins[t, 1] + i, origins[t, 0] + k]
        out[t] = total


@numba.njit(**_COMPILE)
def accumulate(frames, stamps, origins, amplitudes):
    """Add ``amplitudes[t]`` times each stamp to its frame."""
    n_frames, size, _ = stamps.shape
    height, width = frames.shape[1:]
    for t in range(n_frames):
        if amplitudes[t] == 0.0:
            continue
        for i in range(max(0, -origins[t, 1]), min(size, height - origins[t, 1])):
            for k in range(max(0, -origins[t, 0]), min(size, width - origins[t, 0])):
                frames[t, origins[t, 1] + i, origins[t, 0] + k] += np.float32(
                    amplitudes[t] * stamps[t, i, k])


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
def statistic_and_slope(positions, sigma, half, frames, valid, out):
    """Write statistic and its slope in x and y to out[t] = (h, dh/dx, dh/dy).

    The slope leaves out the change of the norm near borders and masks, so it points uphill but
    is exact only away from them.
    """
    n_frames = positions.shape[0]
    height, width = frames.shape[1:]
    scale = -0.5 / (sigma * sigma)
    size = 2 * half + 1
    profile = np.empty(size)
    for t in range(n_frames):
        x_0 = int(math.floor(positions[t, 0] + 0.5)) - half
        y_0 = int(math.floor(positions[t, 1] + 0.5)) - half
        for k in range(size):
            profile[k] = math.exp(scale * (x_0 + k - positions[t, 0])**2)
        total = 0.0
        h = 0.0
        slope_x = 0.0
        slope_y = 0.0
        for y in range(max(0, y_0), min(height, y_0 + size)):
            weight_y = math.exp(scale * (y - positions[t, 1])**2)
            row_h = 0.0
            row_slope = 0.0
            row_total = 0.0
            for x in range(max(0, x_0), min(width, x_0 + size)):
                if valid.shape[0] > 0 and not valid[t, y, x]:
                    continue
                value = profile[x - x_0]
                product = value * frames[t, y, x]
                row_h += product
                row_slope += product * (x - positions[t, 0])
                row_total += value * value
            h += weight_y * row_h
            slope_x += weight_y * row_slope
            slope_y += weight_y * row_h * (y - positions[t, 1])
            total += weight_y * weight_y * row_total
        factor = 1.0 / math.sqrt(total) if total > 1e-6 else 0.0
        out[t, 0] = h * factor
        out[t, 1] = slope_x * factor / (sigma * sigma)
        out[t, 2] = slope_y * factor / (sigma * sigma)
