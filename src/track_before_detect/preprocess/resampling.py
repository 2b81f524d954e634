"""Move images by maps, see the module ``geometry``."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.kernels import warp as warp_kernels
from track_before_detect.preprocess.per_frame import each_frame


def stand_still(maps: NDArray) -> bool:
    """Return whether maps (T, 3, 3) leave the scene at the same place in all frames."""
    return np.array_equal(maps, np.broadcast_to(np.eye(3), maps.shape))


def warped(image: NDArray, matrix: NDArray) -> NDArray:
    """Return an image as it is seen through a map, interpolated by cubic convolution.

    Parameters
    ----------
    image : float32 array, shape (H, W)
        NaN spreads to pixels whose value needs it.
    matrix : array, shape (3, 3)
        Takes positions of the result to those of ``image``.

    Returns
    -------
    float32 array, shape (H, W)
        NaN where the map leads outside the image.
    """
    if np.array_equal(matrix, np.eye(3)):
        return image.copy()
    image, moved = np.ascontiguousarray(image), np.empty(image.shape, image.dtype)
    if geometry.is_translation(matrix):
        warp_kernels.shift(image, float(matrix[0, 2]), float(matrix[1, 2]), moved)
    else:
        warp_kernels.warp(image, matrix, moved)
    return moved


def warped_frames(frames: NDArray, maps: NDArray) -> NDArray:
    """Return every frame of shape (T, H, W) as it is seen through its own map (3, 3)."""
    moved = np.empty(frames.shape, frames.dtype)

    def move(frame: NDArray, matrix: NDArray, out: NDArray) -> None:
        out[:] = warped(frame, matrix)

    each_frame(move, frames, maps, moved)
    return moved


def shift_whole(frame: NDArray, offset: NDArray) -> NDArray:
    """Move an image by whole pixels onto the registered plane.

    Parameters
    ----------
    frame : array, shape (H, W)
        Floating-point pixel values.
    offset : array of int, shape (2,)
        Offset x, y of the scene in this frame.

    Returns
    -------
    array, shape (H, W)
        ``frame`` at each position plus ``offset``, NaN where that is outside.
    """
    height, width = frame.shape
    x, y = (int(value) for value in offset)
    moved = np.full_like(frame, np.nan)
    rows = slice(max(0, -y), min(height, height - y))
    columns = slice(max(0, -x), min(width, width - x))
    if rows.stop > rows.start and columns.stop > columns.start:
        moved[rows, columns] = frame[rows.start + y:rows.stop + y,
                                     columns.start + x:columns.stop + x]
    return moved
