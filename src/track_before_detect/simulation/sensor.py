"""What a sensor makes of point targets: stamps of a Gaussian point spread function, and noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Beyond this many standard deviations a Gaussian is below float32 rounding of its peak.
_REACH_SIGMAS = 6.0


def add_target(frame: NDArray, x: float, y: float, sigma: float, amplitude: float) -> None:
    """Add a target to a frame in place.

    Parameters
    ----------
    frame : array, shape (H, W)
    x, y : float
        Position in pixels; may lie outside the frame.
    sigma : float
        Standard deviation of the point spread function in pixels.
    amplitude : float
        Factor of the unit-norm stamp.
    """
    height, width = frame.shape
    columns, across = _profile(x, sigma)
    rows, down = _profile(y, sigma)
    left, right = np.searchsorted(columns, (0, width))
    top, bottom = np.searchsorted(rows, (0, height))
    if left == right or top == bottom:
        return
    frame[rows[top]:rows[bottom - 1] + 1, columns[left]:columns[right - 1] + 1] += (
        amplitude * np.outer(down[top:bottom], across[left:right]))


def gaussian_stamp_image(shape: tuple[int, int], x: float, y: float,
                         sigma: float) -> NDArray[np.float64]:
    """Return an image of one stamp, sampled at pixel centres.

    The norm is 1 before the stamp is cut at the border of the image.

    Parameters
    ----------
    shape : tuple of int
        Height and width in pixels.
    x, y : float
        Position in pixels.
    sigma : float
        Standard deviation in pixels.

    Returns
    -------
    array, shape (H, W)
    """
    image = np.zeros(shape)
    add_target(image, x, y, sigma, 1.0)
    return image


def _profile(centre, sigma):
    """Return pixel indices around ``centre`` and unit-norm samples of a Gaussian there."""
    reach = max(1, int(np.ceil(_REACH_SIGMAS * sigma)))
    pixels = np.arange(int(np.rint(centre)) - reach, int(np.rint(centre)) + reach + 1)
    samples = np.exp(-0.5 * ((pixels - centre) / sigma) ** 2)
    return pixels, samples / np.linalg.norm(samples)
