"""The standard deviation of the noise, from frames that hold targets and leftovers too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_CUTOFF = 9.0  # median absolute deviations beyond which a value has no weight
_GAUSSIAN = 1.00918  # what the estimate says of unit Gaussian noise
_ENOUGH = 200_000  # values tell the deviation to 0.2 %
_FLOOR_SPREAD = 5 / 3  # half a grey level at the floor of whole numbers, whose median can be 0
_SMOOTHING_PX = 5  # side of the box over which the variance map is averaged


def robust_deviation(values: NDArray, floor: float = 0.0) -> float:
    """Return the standard deviation of the bulk of some values.

    The biweight midvariance about the median: values beyond 9 median absolute deviations have no
    weight. Unlike the median absolute deviation itself it does not move in steps when the values
    are whole numbers.

    Parameters
    ----------
    values : array
        Real values; those that are not finite are left out.
    floor : float, optional
        Least value returned, in the units of ``values``.

    Returns
    -------
    float
        Standard deviation; NaN when no value is finite.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return float('nan')
    finite = finite[::-(-finite.size // _ENOUGH)].astype(np.float64)
    centred = finite - np.median(finite)
    spread = max(float(np.median(np.abs(centred))), _FLOOR_SPREAD * floor)
    if spread == 0:
        return 0.0
    square = (centred / (_CUTOFF * spread)) ** 2
    inside = square < 1
    square, centred = square[inside], centred[inside]
    rest = 1 - square
    above = np.sum(centred ** 2 * rest ** 4)
    below = abs(np.sum(rest * (1 - 5 * square)))
    return max(float(np.sqrt(finite.size * above) / below) / _GAUSSIAN, floor)


def frame_level(frames: NDArray, floor: float = 0.0) -> NDArray:
    """Return one noise level per frame.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames without background, NaN where masked.
    floor : float, optional
        Least level, in the units of ``frames``.

    Returns
    -------
    array, shape (T, 1, 1)
        Standard deviation; NaN for a frame that is masked entirely.
    """
    levels = [robust_deviation(frame, floor) for frame in frames]
    return np.array(levels)[:, None, None]


def pixel_level(frames: NDArray, floor: float = 0.0) -> NDArray:
    """Return one noise level per pixel.

    The spread over time of each pixel, averaged in variance over a few pixels around, and scaled
    so that the bulk of all values has unit deviation after division. A target that stays on a
    pixel for half of the frames or longer counts as noise there.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames, NaN where masked.
    floor : float, optional
        Least level, in the units of ``frames``.

    Returns
    -------
    array, shape (1, H, W)
        Standard deviation; NaN where a pixel is masked in every frame.
    """
    # imported here to keep the two estimates of what does not move in one place
    from track_before_detect.preprocess.background import temporal_median

    centred = frames - temporal_median(frames)
    variance = (1.4826 * temporal_median(np.abs(centred))) ** 2
    known = np.isfinite(variance)
    if not known.any():
        return np.full((1, *frames.shape[1:]), np.nan)
    weight = ndimage.uniform_filter(known.astype(np.float64), _SMOOTHING_PX, mode='nearest')
    mean = ndimage.uniform_filter(np.where(known, variance, 0.0).astype(np.float64),
                                  _SMOOTHING_PX, mode='nearest')
    level = np.sqrt(np.where(known, mean / np.maximum(weight, 1e-9), np.nan))
    overall = robust_deviation(centred, floor)
    level = np.maximum(level, max(floor, 1e-3 * overall))
    scale = robust_deviation(centred / level)
    return np.maximum(level * (scale or 1.0), floor)[None]
