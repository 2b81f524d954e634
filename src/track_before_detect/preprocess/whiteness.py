"""Whether the noise is white, and what the matched filter sees of it where it is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.preprocess.robust import robust_deviation

_SIGNIFICANT = 3.0  # deviations by which noise must differ from white
_FRAMES_USED = 8


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
    reach = int(np.ceil(4 * width_px))
    profile = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width_px) ** 2)
    outputs = []
    for frame in frames[::-(-len(frames) // _FRAMES_USED)]:
        finite = np.isfinite(frame)
        signal = np.where(finite, frame, frame.dtype.type(0))
        power = finite.astype(frame.dtype)
        for axis in (0, 1):
            signal = ndimage.correlate1d(signal, profile, axis=axis, mode='constant')
            power = ndimage.correlate1d(power, profile ** 2, axis=axis, mode='constant')
        outputs.append(signal[finite] / np.sqrt(power[finite]))
    values = np.concatenate(outputs)
    factor = robust_deviation(values)
    n_independent = max(values.size / (4 * np.pi * width_px ** 2), 1.0)
    return factor if factor > 1 + _SIGNIFICANT / np.sqrt(2 * n_independent) else 1.0
