"""Pixels that hold no picture: rows of telemetry, dead and hot pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.preprocess.noise import robust_deviation

# Rows or columns from the border that may hold counters, clocks and temperatures.
WIDEST_STRIP = 8
# Noise deviations by which a strip jumps off the picture, and the share of its pixels that do.
JUMP = 20.0
LEAST_SHARE = 0.5
# Noise deviations by which a hot pixel stands out of its neighbours in every frame, and the share
# of that which the nearest of them may have: the sharpest PSF leaves them more.
HOT = 10.0
MOST_SPILLED = 0.1
# Share of the pixels above which what stands out is the picture.
MOST_PIXELS = 0.01


@dataclass(frozen=True)
class BadPixels:
    """Which pixels hold no picture.

    Attributes
    ----------
    mask : array of bool, shape (H, W)
        True where one does not.
    remarks : list of str
        A sentence for each kind that was found.
    """

    mask: NDArray[np.bool_]
    remarks: list[str]


def bad_pixels(frames: NDArray) -> BadPixels:
    """Find the pixels of a batch that hold no picture.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values as they came, NaN where masked; at least 3 frames.
    """
    mask = np.zeros(frames.shape[1:], bool)
    remarks: list[str] = []
    deviation = robust_deviation(np.diff(frames, axis=0)) / 2**0.5
    if not (len(frames) > 2 and deviation > 0):
        return BadPixels(mask, remarks)
    with np.errstate(invalid='ignore'):
        middle = np.median(frames, axis=0)
    for axis, name in ((0, 'row'), (1, 'column')):
        for last in (False, True):
            _mask_strip(mask, remarks, frames, deviation, axis, last, name)
    nearest = ndimage.distance_transform_edt(mask | ~np.isfinite(middle),
                                             return_distances=False, return_indices=True)
    middle = middle[tuple(nearest)]
    excess = np.abs(middle - ndimage.median_filter(middle, 5))
    around = ndimage.maximum_filter(excess, footprint=_RING)
    still = np.std(frames, axis=0)
    neighbours = ndimage.median_filter(still, 5)
    for kind, found in (
            ('hot', (excess > HOT * deviation) & (around < MOST_SPILLED * excess)),
            ('dead', (still == 0) & (neighbours > 0.5 * deviation))):
        found &= ~mask
        if 0 < found.sum() <= MOST_PIXELS * found.size:
            mask |= found
            y, x = np.argwhere(found)[0]
            remarks.append(f'{int(found.sum())} {kind} pixels are masked, the first at x = {x}, '
                           f'y = {y}')
    return BadPixels(mask, remarks)


_RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)


def _mask_strip(mask: NDArray[np.bool_], remarks: list[str], frames: NDArray, deviation: float,
                axis: int, last: bool, name: str) -> None:
    """Mask the lines at one border that jump off the picture beside them in every frame."""
    lines = np.moveaxis(frames, axis + 1, 1)
    lines = lines[:, ::-1] if last else lines
    n_lines = lines.shape[1]
    for width in range(min(WIDEST_STRIP, n_lines // 4), 0, -1):
        # A steep scene changes as much from line to line within the picture.
        slope = np.abs(lines[:, width:width + 3] - lines[:, width + 1:width + 4]).max(axis=1)
        jumps = np.abs(lines[:, width - 1] - lines[:, width]) > JUMP * deviation + 2 * slope
        if np.mean(jumps, axis=1).min() >= LEAST_SHARE:
            numbers = [n_lines - width, n_lines - 1] if last else [0, width - 1]
            strip = [slice(None), slice(None)]
            strip[axis] = slice(numbers[0], numbers[1] + 1)
            mask[tuple(strip)] = True
            which = (f'{name} {numbers[0]} is' if width == 1
                     else f'{name}s {numbers[0]} to {numbers[1]} are')
            remarks.append(f'{which} masked: no part of the picture')
            return
