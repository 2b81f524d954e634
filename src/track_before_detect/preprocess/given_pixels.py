"""What is given of the pixels of a batch: which are masked, and how noisy each is."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.array_option import ArrayOption
from track_before_detect.errors import DataError
from track_before_detect.types import FrameBatch


def masked_pixels(given: ArrayOption, batch: FrameBatch) -> NDArray[np.bool_]:
    """Return which pixels of a batch hold no data, shape (T, H, W) or (1, H, W)."""
    masked = _of_batch('mask', given, batch) != 0
    if masked.all() and np.all(given.array):
        raise DataError('mask must be 0 where a pixel holds data, got one that is 0 nowhere')
    return masked


def given_level(given: ArrayOption, batch: FrameBatch) -> NDArray[np.float64]:
    """Return the standard deviation of the noise, shape (T, H, W) or (1, H, W).

    NaN where the variance is not finite.
    """
    variance = _of_batch('variance', given, batch).astype(np.float64)
    known = np.isfinite(variance)
    if not known.any() or np.any(variance[known] <= 0):
        least = f'got {variance[known].min():g}' if known.any() else 'got no finite value'
        raise DataError(f'variance must be above 0, {least}')
    return np.sqrt(np.where(known, variance, np.nan))


def _of_batch(name: str, given: ArrayOption, batch: FrameBatch) -> NDArray:
    """Return the entries of an array for the frames of a batch."""
    array = given.array
    shape = np.shape(batch.frames)[1:]
    if array.ndim not in (2, 3) or array.shape[-2:] != shape:
        raise DataError(
            f'{name} must have the shape (H, W) or (frames, H, W) of the frames, which are '
            f'{shape[0]} x {shape[1]}, got {array.shape}')
    if array.ndim == 2:
        return array[None]
    last = int(np.max(batch.frame_indices))
    if last >= len(array):
        raise DataError(f'{name} must have an entry for every frame, got {len(array)} entries '
                        f'for frame {last}')
    return array[batch.frame_indices]
