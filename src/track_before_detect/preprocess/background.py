"""What does not move: estimated as a median over time and taken off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from track_before_detect.preprocess.registration import shift_fraction

_LEAST_SHARE = 1 / 3  # of the frames must show a pixel, or nothing is known about it


def temporal_median(frames: NDArray) -> NDArray:
    """Return the median over time of each pixel.

    A target that stays on a pixel for half of the frames or longer becomes part of the
    background there: it is weakened, or gone, and leaves a hole where it was absent.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values; those that are not finite are left out.

    Returns
    -------
    array, shape (H, W)
        The median, NaN where fewer than a third of the frames are finite.
    """
    n_frames = len(frames)
    ordered = np.ascontiguousarray(np.moveaxis(frames, 0, -1))
    ordered[~np.isfinite(ordered)] = np.nan
    # NaN sorts behind every number
    ordered.sort(axis=-1)
    count = n_frames - np.isnan(ordered).sum(axis=-1)
    if np.all(count == n_frames):
        return 0.5 * (ordered[..., (n_frames - 1) // 2] + ordered[..., n_frames // 2])
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)
    high = np.take_along_axis(ordered, count[..., None] // 2, axis=-1)
    median = 0.5 * (low + high)[..., 0]
    median[count < _LEAST_SHARE * n_frames] = np.nan
    return median


def remove_temporal_median(frames: NDArray, fractions: NDArray) -> NDArray:
    """Take the background off registered frames.

    The frames keep their own grid, so that their noise stays white: they are moved by fractions
    of a pixel only to find the background, which is then moved back to each of them. The level
    of each frame is taken off as well; the gain of a camera drifts.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames moved onto the registered plane by whole pixels, NaN where masked.
    fractions : array, shape (T, 2)
        What is left of the offset x, y of each, in pixels.

    Returns
    -------
    array, shape (T, H, W)
        Frames without background, NaN where masked or where the background is not known.
    """
    aligned = np.stack([shift_fraction(frame, fraction)
                        for frame, fraction in zip(frames, fractions, strict=True)])
    reference = aligned[len(aligned) // 2]
    for frame in aligned:
        frame -= _level(frame - reference)
    background = temporal_median(aligned)
    residual = np.empty_like(frames)
    for index, frame in enumerate(frames):
        residual[index] = frame - shift_fraction(background, -fractions[index])
        residual[index] -= _level(residual[index])
    return residual


def _level(difference):
    """Return the median of the finite values, 0 without any."""
    # a quarter of the pixels tells a median well enough
    part = difference[::2, ::2]
    finite = part[np.isfinite(part)]
    return np.median(finite) if finite.size else difference.dtype.type(0)
