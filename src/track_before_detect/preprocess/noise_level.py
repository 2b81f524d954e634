"""The standard deviation of the noise, from frames that hold targets and leftovers too."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.kernels import warp
from track_before_detect.kernels.pictures.boxes import ring_level
from track_before_detect.preprocess.background import temporal_median
from track_before_detect.preprocess.per_frame import each_frame
from track_before_detect.preprocess.resampling import stand_still, warped_frames
from track_before_detect.preprocess.robust import MAD_TO_DEVIATION, robust_deviation

_RING_WIDTHS = 3, 7  # half sides of the ring of a pixel, in widths of a target
_SMOOTHING_PX = 5  # side of the box over which the variance map is averaged


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
    levels = each_frame(lambda frame: robust_deviation(frame, floor), frames)
    return np.array(levels)[:, None, None]


def _ring_sides(width_px: float) -> tuple[int, int]:
    """Return the inner and the outer side of the ring of a pixel."""
    inner, outer = (2 * round(side * width_px) + 1 for side in _RING_WIDTHS)
    return inner, outer


def local_level(frame: NDArray, floor: float, width_px: float) -> NDArray:
    """Return the noise level around each pixel of a frame.

    The larger of the level of the frame and the root mean square in a square ring around the
    pixel; the square inside it keeps a target from being scaled by itself. Leftovers of roofs and
    tree lines then count as little as their surroundings say.

    Parameters
    ----------
    frame : array, shape (H, W)
        Real, without background, NaN where masked.
    floor : float
        Least level, in the units of ``frame``.
    width_px : float
        Standard deviation of a target in pixels.

    Returns
    -------
    float32 array, shape (H, W)
        Level; NaN for a frame that is masked entirely.
    """
    inner, outer = _ring_sides(width_px)
    # A quarter of the pixels tells the level of a frame well enough.
    whole = robust_deviation(frame[::2, ::2], floor)
    if np.isnan(whole):
        whole = robust_deviation(frame, floor)
    level = np.full(frame.shape, whole, np.float32)
    if not np.isnan(whole):
        ring_level(frame, inner, outer, whole, level)
    return level


def lasting_level(frames: NDArray, maps: NDArray, width_px: float) -> NDArray:
    """Return the level around each pixel of what all frames show together.

    What stays at a place of the scene adds up over the frames as a target does, noise only as the
    square root of their number. So in frames of much noise leftovers too weak to be seen in any
    are what stands out in a batch, and their level is that of the sum over the frames, divided by
    that root: the deviation of white noise, and more where something lasts.

    Parameters
    ----------
    frames, maps : arrays, shapes (T, H, W) and (T, 3, 3)
        Real frames, NaN where masked, and what takes the registered plane to each of them.
    width_px : float
        Standard deviation of a target in pixels.

    Returns
    -------
    float32 array, shape (1, H, W) or (T, H, W)
        Root mean square in the ring of :func:`local_level`; that nearest by beyond the plane.
    """
    on_plane = frames if stand_still(maps) else warped_frames(frames, maps)
    number = np.maximum(np.isfinite(on_plane).sum(axis=0), 1)
    total = np.nansum(on_plane, axis=0) / np.sqrt(number, dtype=np.float32)
    inner, outer = _ring_sides(width_px)
    level = np.empty((1, *total.shape), np.float32)
    ring_level(total, inner, outer, 0.0, level[0])
    if on_plane is frames:
        return level
    # It is smooth: the nearest pixel will do.
    seen = np.empty(frames.shape, np.float32)
    each_frame(lambda out, matrix: warp.nearest(level[0], matrix, out), seen,
               geometry.inverse(maps))
    return seen


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
    variance = (MAD_TO_DEVIATION * temporal_median(np.abs(centred))) ** 2
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


def scene_level(frames: NDArray, maps: NDArray, floor: float = 0.0) -> NDArray:
    """Return the noise level of each place of the scene, at the pixels of each frame.

    Parameters
    ----------
    frames, maps : arrays, shapes (T, H, W) and (T, 3, 3)
        Real frames, NaN where masked, and what takes the registered plane to each of them.
    floor : float, optional
        Least level, in the units of ``frames``.

    Returns
    -------
    array, shape (T, H, W)
        Standard deviation; NaN where nothing is known of it.
    """
    level = pixel_level(warped_frames(frames, maps), floor).astype(np.float32)
    level = warped_frames(np.broadcast_to(level, frames.shape), geometry.inverse(maps))
    # interpolation took part of the noise, and may dip below zero beside a step
    scale = robust_deviation(frames / np.maximum(level, np.float32(1e-6)))
    return np.maximum(level * (scale or 1.0), floor)
