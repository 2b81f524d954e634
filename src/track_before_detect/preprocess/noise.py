"""The standard deviation of the noise, from frames that hold targets and leftovers too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.preprocess.background import temporal_median

_CUTOFF = 9.0  # median absolute deviations beyond which a value has no weight
_GAUSSIAN = 1.00918  # what the estimate says of unit Gaussian noise
_ENOUGH = 200_000  # values tell the deviation to 0.2 %
_FLOOR_SPREAD = 5 / 3  # half a grey level at the floor of whole numbers, whose median can be 0
_SIGNIFICANT = 3.0  # deviations by which noise must differ from white
_FRAMES_LOOKED_AT = 8
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
    centred = frames - temporal_median(frames)
    variance = (1.4826 * temporal_median(np.abs(centred))) ** 2
    known = np.isfinite(variance)
    if not known.any():
        return np.full((1, *frames.shape[1:]), np.nan)
    weight = ndimage.uniform_filter(known.astype(np.float64), _SMOOTHING_PX, mode='nearest')
    mean = ndimage.uniform_filter(np.where(known, variance, 0.0).astype(np.float64),
                                  _SMOOTHING_PX, mode='nearest')
    # the running sums of the filter may end a rounding error below 0
    mean = np.maximum(mean, 0.0) / np.maximum(weight, 1e-9)
    level = np.sqrt(np.where(known, mean, np.nan))
    overall = robust_deviation(centred, floor)
    level = np.maximum(level, max(floor, 1e-3 * overall))
    if not np.any(level > 0):
        return level[None]
    scale = robust_deviation(centred / level)
    return np.maximum(level * (scale or 1.0), floor)[None]


def correlation_factor(frames: NDArray, psf_sigma_px: float) -> float:
    """Return how much stronger the noise is at the scale of a target than if it were white.

    Compression and what is left of the background correlate the noise of neighbouring pixels.
    The matched filter then sees more of it than the deviation of a pixel says, and dividing by
    this factor as well gives its output unit variance again.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames in units of the noise standard deviation, NaN where masked.
    psf_sigma_px : float
        Standard deviation of the Gaussian point spread function in pixels.

    Returns
    -------
    float
        Robust deviation of the matched filter's output; 1 unless it is clearly above that.
    """
    reach = int(np.ceil(4 * psf_sigma_px))
    profile = np.exp(-0.5 * (np.arange(-reach, reach + 1) / psf_sigma_px) ** 2)
    outputs = []
    for frame in frames[::-(-len(frames) // _FRAMES_LOOKED_AT)]:
        finite = np.isfinite(frame)
        signal = np.where(finite, frame, frame.dtype.type(0))
        power = finite.astype(frame.dtype)
        for axis in (0, 1):
            signal = ndimage.correlate1d(signal, profile, axis=axis, mode='constant')
            power = ndimage.correlate1d(power, profile ** 2, axis=axis, mode='constant')
        outputs.append(signal[finite] / np.sqrt(power[finite]))
    values = np.concatenate(outputs)
    factor = robust_deviation(values)
    n_independent = max(values.size / (4 * np.pi * psf_sigma_px ** 2), 1.0)
    return factor if factor > 1 + _SIGNIFICANT / np.sqrt(2 * n_independent) else 1.0
