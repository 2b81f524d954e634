"""Stamps and statistics of a path on a plane that each frame sees in its own way.

A position of the plane is at ``maps[t]`` of it in frame t (see the module ``geometry``), where the
target looks as the optics of the sensor say that took the frame. Without maps the plane is that of
the frames, and one sensor took them all.
"""

from collections import namedtuple
import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT
from track_before_detect.kernels.psf.psf_profiles import smear_of
from track_before_detect.kernels.psf.psf_stamps import render, statistic_and_slope

_FAR_AWAY = -1e6

CompiledMeasurement = namedtuple('CompiledMeasurement', ('optics', 'sensor', 'maps'))
"""How the frames see positions.

Attributes
----------
optics : tuple of Optics
    One for each sensor, see the module ``psf_profiles``.
sensor : int64 (T,)
    Which of them took each frame.
maps : float64 (T, 3, 3)
    Of the plane to each frame; of no frames where positions are those in the frames.
"""


@numba.njit(**EXACT)
def map_position(matrix, x, y, slope):
    """Return where a map takes (x, y); ``slope`` (2, 2) gets its derivative."""
    depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    if not depth > 0.0:
        slope[:] = 0.0
        return _FAR_AWAY, _FAR_AWAY
    u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / depth
    v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / depth
    for axis in range(2):
        slope[0, axis] = (matrix[0, axis] - u * matrix[2, axis]) / depth
        slope[1, axis] = (matrix[1, axis] - v * matrix[2, axis]) / depth
    return u, v


@numba.njit(**EXACT)
def _seen_at(compiled, positions, weights, t, at, slope):
    """Write the place in frame t to ``at`` (1, 2), its derivative to ``slope``; return weights."""
    at[0, 0], at[0, 1] = map_position(compiled.maps[t], positions[t, 0], positions[t, 1], slope)
    return weights[t:t + 1] if weights.shape[0] > 1 else weights


@numba.njit(**EXACT)
def render_path(compiled, positions, height, width, weights, stamps, origins, norms):
    """Fill ``stamps``, ``origins`` and ``norms`` as ``stamps.render`` does.

    A sensor whose stamps are smaller than others' fills their first rows and columns.
    """
    if compiled.maps.shape[0] == 0:
        render(compiled.optics[0], positions, height, width, weights, stamps, origins, norms)
        return
    at = np.empty((1, 2))
    slope = np.empty((2, 2))
    for t in range(positions.shape[0]):
        own = _seen_at(compiled, positions, weights, t, at, slope)
        render(compiled.optics[compiled.sensor[t]], at, height, width, own, stamps[t:t + 1],
               origins[t:t + 1], norms[t:t + 1])


@numba.njit(**EXACT)
def evaluate(compiled, positions, frames, weights, model, out, norms):
    """Write statistic and its slope on the plane as ``stamps.statistic_and_slope`` does."""
    if compiled.maps.shape[0] == 0:
        statistic_and_slope(compiled.optics[0], positions, frames, weights, model, out, norms)
        return
    at = np.empty((1, 2))
    slope = np.empty((2, 2))
    for t in range(positions.shape[0]):
        own = _seen_at(compiled, positions, weights, t, at, slope)
        statistic_and_slope(compiled.optics[compiled.sensor[t]], at, frames[t:t + 1], own, model,
                            out[t:t + 1], norms[t:t + 1])
        in_x, in_y = out[t, 1], out[t, 2]
        out[t, 1] = in_x * slope[0, 0] + in_y * slope[1, 0]
        out[t, 2] = in_x * slope[0, 1] + in_y * slope[1, 1]


@numba.njit(**EXACT)
def curvatures(compiled, positions, out):
    """Write to out[t] the curvature (x, y) on the plane, see ``Optics``."""
    slope = np.zeros((2, 2))
    slope[0, 0] = slope[1, 1] = 1.0
    for t in range(positions.shape[0]):
        if compiled.maps.shape[0] > 0:
            map_position(compiled.maps[t], positions[t, 0], positions[t, 1], slope)
        own = compiled.optics[compiled.sensor[t] if compiled.maps.shape[0] > 0 else 0].curvature
        for axis in range(2):
            out[t, axis] = own[0] * slope[0, axis]**2 + own[1] * slope[1, axis]**2


@numba.njit(**EXACT)
def smear_curvatures(optics, positions, curvature, cross):
    """Lower curvatures (T, 2) along the smear, write how x and y are joined to ``cross`` (T,).

    As for a Gaussian: at distance d along the smear two of its nodes overlap by
    exp(-curvature d^2 / 2).
    """
    for t in range(positions.shape[0]):
        x, y = smear_of(optics, positions, t)
        squared = x * x + y * y
        cross[t] = 0.0
        if squared == 0.0:
            continue
        along = (curvature[t, 0] * x * x + curvature[t, 1] * y * y) / squared
        bend = 0.0
        norm = 0.0
        for m in range(optics.nodes.size):
            for n in range(optics.nodes.size):
                apart = along * squared * (optics.nodes[m] - optics.nodes[n])**2
                share = optics.shares[m] * optics.shares[n] * math.exp(-0.5 * apart)
                bend += share * (1.0 - apart)
                norm += share
        lost = along * (1.0 - max(bend / norm, 0.05)) / squared
        curvature[t, 0] -= lost * x * x
        curvature[t, 1] -= lost * y * y
        cross[t] = -lost * x * y


@numba.njit(**EXACT)
def sharpest(curvature):
    """Return the standard deviation in pixels of the sharpest Gaussian of ``curvatures``."""
    most = 1e-300
    for t in range(curvature.shape[0]):
        most = max(most, curvature[t, 0] + curvature[t, 1])
    return 1.0 / math.sqrt(most)


def whole_norm(compiled, shape):
    """Return the norm of a stamp amid frames (H, W): less than one in those of one row or column.

    Such a frame is all that its sensor could ever see of a target.
    """
    if min(shape) > 1:
        return 1.0
    size = 2 * max(optics.half for optics in compiled.optics) + 1
    height, width = [1 if side == 1 else 2 * size + 1 for side in shape]
    norms = np.empty(1)
    render_path(compiled, np.array([[width // 2, height // 2]], np.float64), height, width,
                np.zeros((0, 0, 0), np.float32), np.empty((1, size, size)),
                np.empty((1, 2), np.int64), norms)
    return float(norms[0])
