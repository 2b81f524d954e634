"""Noise that follows the scene: brighter pixels count more photons, and slopes show what moved."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

_ROUNDS = 5  # of a fit in which outlying pixels count less each time
_OUTLYING = 3.0  # deviations beyond which a pixel is taken for a target or a leftover
_MOST_PIXELS = 30_000  # that are fitted


def scene_noise(residual: NDArray, frames: NDArray) -> NDArray[np.float32] | None:
    """Return the deviation of the noise at each pixel as brightness and slope explain it.

    The variance is fitted as a + b I + c |grad I|^2 with the background I: b is the shot noise of
    a photon count, c the variance of what is left of a motion, of the camera or of leaves.

    Parameters
    ----------
    residual : array, shape (T, H, W)
        Frames without background, NaN where masked.
    frames : array, shape (T, H, W)
        With the background.

    Returns
    -------
    array of float32, shape (T, H, W), or None
        None where the noise is the same everywhere.
    """
    background = frames - residual
    level = np.nanmin(background)
    slope = _slope_power(background)
    step = max(residual.size // _MOST_PIXELS, 1) | 1
    r, i, s = (part.reshape(-1)[::step].astype(np.float64)
               for part in (residual, background - level, slope))
    known = np.isfinite(r) & np.isfinite(i) & np.isfinite(s)
    if known.sum() < 1000:
        return None
    power, terms = r[known]**2, np.stack([np.ones(known.sum()), i[known], s[known]], axis=1)
    scales = np.maximum(terms.mean(axis=0), 1e-30)
    terms = terms / scales
    variance = np.full(len(power), np.median(power) / 0.455)
    if not variance[0] > 0:
        return None
    for _ in range(_ROUNDS):
        seen = np.minimum(power, _OUTLYING**2 * variance) * 1.03
        factors, _ = nnls(terms / variance[:, None], seen / variance)
        if not factors.any():
            return None
        variance = np.maximum(terms @ factors, 1e-6 * factors.sum())
    if factors[0] <= 0 and not factors[1:].any():
        return None
    a, b, c = factors / scales
    fitted = (np.float32(a) + np.float32(b) * (background - level)
              + np.float32(c) * slope)
    noise = np.sqrt(np.maximum(fitted, np.float32(1e-6 * factors.sum())))
    return noise / np.nanmedian(noise)


def _slope_power(frames: NDArray) -> NDArray[np.float32]:
    """Return the squared slope of each pixel of each frame."""
    power = np.empty_like(frames)
    for frame, out in zip(frames, power, strict=True):
        dy, dx = np.gradient(frame)
        out[...] = dx**2 + dy**2
    return power
