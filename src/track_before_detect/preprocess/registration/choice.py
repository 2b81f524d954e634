"""Which map leads from the scene to the frames: none, a shift, or one with turns and zooms.

A map that can do more also follows more of what moves by itself in front of a still camera, as
leaves do. So it is taken only where it leaves less of the scene in most parts of the picture.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import functools

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.kernels.pictures.boxes import box_mean
from track_before_detect.preprocess.registration.registration import (
    register_features,
    Registration,
)
from track_before_detect.preprocess.resampling import warped

# Side of the tiles in which what is left is compared, and the least one of small frames, which
# are to have some tiles as well.
_TILE_PX, _LEAST_TILE_PX, _TILES = 16, 4, 8
# Deviations of the sum over the tiles by which a map that can do more has to leave less.
_BETTER = 4.0
# Side of the box whose mean is compared.
_SMOOTH_PX = 5
# Frames, as shares of the batch, in which they are compared with the reference.
_LOOKED_AT = (0.0, 0.25, 0.75, 1.0)


def register_simply(features: Sequence[NDArray]) -> Registration:
    """Find where the scene of the middle frame is in each frame by the simplest map that does.

    Parameters
    ----------
    features : sequence of array, shape (2, H, W)
        Of each frame, see ``features_of``.
    """
    shifts = register_features(features, 'translation')
    numbers = _frames_looked_at(shifts)
    if not len(numbers):
        return shifts
    smooth = functools.cache(lambda t: _smooth(features[t][0]))
    still = replace(shifts, maps=geometry.translations(np.zeros((len(features), 2))))
    chosen = _better(smooth, shifts.reference, numbers, still, shifts)
    ends = np.unique([numbers[0], shifts.reference, numbers[-1]])
    middle = int(np.searchsorted(ends, shifts.reference))
    tried = register_features([features[t] for t in ends], 'affine', middle)
    turned = replace(chosen, maps=chosen.maps.copy())
    turned.maps[ends] = tried.maps
    if (tried.credible & tried.refined).all() and _better(
            smooth, shifts.reference, ends[ends != shifts.reference], chosen,
            turned) is turned:
        return register_features(features, 'affine', shifts.reference)
    return chosen


def _frames_looked_at(found: Registration) -> NDArray[np.intp]:
    """Return the numbers of frames far from the reference whose place in the scene is known."""
    credible = np.flatnonzero(found.credible)
    chosen = np.rint(np.array(_LOOKED_AT) * (len(credible) - 1)).astype(int)
    return np.setdiff1d(credible[chosen], [found.reference])


def _better(smooth: Callable[[int], NDArray], reference: int, numbers: NDArray,
            simple: Registration, able: Registration) -> Registration:
    """Return the second of two registrations where it leaves clearly less, or the first.

    ``smooth`` returns the features of a frame, smoothed, by its number.
    """
    gain = np.concatenate([
        _left(smooth(reference), smooth(t), simple.maps[t])
        - _left(smooth(reference), smooth(t), able.maps[t]) for t in numbers.tolist()])
    gain = gain[np.isfinite(gain)]
    return able if gain.sum() > _BETTER * np.sqrt(np.sum(gain**2)) else simple


def _left(fixed: NDArray, moving: NDArray, matrix: NDArray) -> NDArray[np.float64]:
    """Return what of two features is not alike in each tile, NaN where it is not known."""
    left = np.abs(warped(moving, matrix) - fixed)
    rows, columns = (max(side // min(_TILE_PX, max(side // _TILES, _LEAST_TILE_PX)), 1)
                     for side in left.shape)
    tall, wide = left.shape[0] // rows, left.shape[1] // columns
    tiles = left[:rows * tall, :columns * wide].reshape(rows, tall, columns, wide)
    return tiles.mean(axis=(1, 3)).ravel()


def _smooth(image: NDArray) -> NDArray[np.float32]:
    """Return an image of which interpolation takes no noise."""
    smooth = np.empty_like(image)
    box_mean(image, _SMOOTH_PX, smooth)
    return smooth
