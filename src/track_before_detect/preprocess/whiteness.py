"""Whether the noise is white, and what the matched filter sees of it where it is not."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.pictures import matched_statistic as kernels
from track_before_detect.preprocess.per_frame import each_frame
from track_before_detect.preprocess.robust import robust_deviation

_SIGNIFICANT = 3.0  # deviations by which noise must differ from white
_FRAMES_USED = 8
_WHITE = 0.1  # likeness of neighbouring pixels up to which noise counts as white


def coloured_noise_factor(frames: NDArray, width_px: float) -> float:
    """Return how much stronger the noise is at the scale of a target than if it were white.

    Compression and what is left of the background correlate the noise of neighbouring pixels.
    The matched filter then sees more of it than the deviation of a pixel says, and dividing by
    this factor as well gives its output unit variance again.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames in units of the noise standard deviation, NaN where masked.
    width_px : float
        Standard deviation of a target in pixels, taken to be Gaussian.

    Returns
    -------
    float
        Robust deviation of the matched filter's output; 1 unless it is clearly above that.
    """
    def known(frame: NDArray) -> NDArray:
        output = matched_statistic(frame, width_px)
        return output[np.isfinite(output)]

    values = np.concatenate(each_frame(known, frames[::-(-len(frames) // _FRAMES_USED)]))
    factor = robust_deviation(values)
    n_independent = max(values.size / (4 * np.pi * width_px ** 2), 1.0)
    return factor if factor > 1 + _SIGNIFICANT / np.sqrt(2 * n_independent) else 1.0


def differ_by_white_noise(frames: NDArray) -> bool:
    """Return whether what changes from frame to frame is noise, independent from pixel to pixel.

    So it is where the noise of a sensor outweighs what compression and a moving scene change.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values in any unit, NaN where masked.
    """
    changes = np.diff(frames[:_FRAMES_USED + 1].astype(np.float32), axis=0)
    deviation = robust_deviation(changes)
    if not deviation > 0:
        return False
    changes /= deviation
    return all(autocorrelation(changes, axis, 1)[-1] < _WHITE for axis in (1, 2))


def matched_statistic(frame: NDArray, width_px: float) -> NDArray:
    """Return a frame (H, W) as the matched filter of a Gaussian target sees it.

    Parameters
    ----------
    frame : array, shape (H, W)
        Real or complex, in units of the noise standard deviation, NaN where masked.
    width_px : float
        Standard deviation of a target in pixels.

    Returns
    -------
    array, shape (H, W)
        Of unit variance where noise is white; NaN where masked.
    """
    reach = int(np.ceil(4 * width_px))
    profile = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width_px) ** 2)
    if np.iscomplexobj(frame):
        parts = [matched_statistic(part, width_px) for part in (frame.real, frame.imag)]
        return np.stack(parts, axis=-1).view(frame.dtype)[..., 0]
    seen = np.empty(frame.shape, frame.dtype)
    kernels.matched_statistic(np.ascontiguousarray(frame), profile.astype(frame.dtype), seen)
    return seen


def autocorrelation(frames: NDArray, axis: int, most_lags: int,
                    clip: float = 5.0) -> NDArray[np.float64]:
    """Return how much frames of unit noise resemble themselves, shifted along an axis.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real or complex frames, NaN where masked.
    axis : int
        0 compares each pixel with itself in later frames, 1 and 2 with its neighbours.
    most_lags : int
        Largest shift.
    clip : float
        Values beyond count as this, so that a few targets do not decide.

    Returns
    -------
    array, shape (lags + 1,)
        1 at no shift, near 0 beyond where noise is white; NaN where nothing is known. No more
        lags than half of the axis.
    """
    parts = np.stack([frames.real, frames.imag]) if np.iscomplexobj(frames) else frames[None]
    values = np.moveaxis(np.clip(parts, -clip, clip), axis + 1, 0)
    values = values - np.nanmean(values)
    size = len(values)
    products = [values[lag:] * values[:size - lag]
                for lag in range(min(most_lags, size // 2) + 1)]
    covariance = np.array([np.nansum(product) / max(np.isfinite(product).sum(), 1)
                           for product in products])
    return covariance / covariance[0] if covariance[0] > 0 else np.full(len(products), np.nan)
