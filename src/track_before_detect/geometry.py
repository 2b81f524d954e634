"""Maps between planes: affine or projective, one 3 x 3 matrix for each frame.

A matrix takes homogeneous coordinates (x, y, 1) of the common plane to the pixels of a frame, up
to a factor; its last entry is 1.
"""

import numpy as np
from numpy.typing import NDArray


def translations(offsets: NDArray) -> NDArray[np.float64]:
    """Return the maps that add an offset x, y to every position.

    Parameters
    ----------
    offsets : array, shape (T, 2)
        Pixels.

    Returns
    -------
    array, shape (T, 3, 3)
    """
    maps = np.tile(np.eye(3), (len(offsets), 1, 1))
    maps[:, :2, 2] = offsets
    return maps


def is_translation(matrix: NDArray) -> bool:
    """Return whether a map (3, 3) adds an offset, and does nothing else."""
    return bool(np.array_equal(matrix[:, :2], np.eye(3, 2)) and matrix[2, 2] == 1)


def inverse(maps: NDArray) -> NDArray[np.float64]:
    """Return the maps back, shape (..., 3, 3)."""
    back = np.linalg.inv(maps)
    return back / back[..., 2:, 2:]


def apply(maps: NDArray, positions: NDArray) -> NDArray[np.float64]:
    """Return where maps take positions.

    Parameters
    ----------
    maps : array, shape (..., 3, 3)
        Maps; their first axes broadcast against those of ``positions``.
    positions : array, shape (..., 2)
        x and y.

    Returns
    -------
    array, shape (..., 2)
        NaN where a position lies on or behind the horizon of a projective map.
    """
    x, y = positions[..., 0], positions[..., 1]

    def scaled(row: int) -> NDArray[np.float64]:
        return maps[..., row, 0] * x + maps[..., row, 1] * y + maps[..., row, 2]

    # Number by number: NumPy is slow along an axis of two or three.
    depth = scaled(2)
    depth = np.where(depth > 0, depth, np.nan)
    mapped = np.empty((*depth.shape, 2))
    for row in range(2):
        np.divide(scaled(row), depth, out=mapped[..., row])
    return mapped


def slopes(maps: NDArray, positions: NDArray) -> NDArray[np.float64]:
    """Return the derivatives of maps at positions.

    Parameters
    ----------
    maps : array, shape (T, 3, 3)
    positions : array, shape (T, 2)
        x and y before the map.

    Returns
    -------
    array, shape (T, 2, 2)
        Of x and y (rows) by x and y before the map (columns); NaN as of :func:`apply`.
    """
    depth = np.einsum('ti,ti->t', maps[:, 2, :2], positions) + maps[:, 2, 2]
    mapped = apply(maps, positions)
    return (maps[:, :2, :2] - mapped[:, :, None] * maps[:, 2:, :2]) / depth[:, None, None]
