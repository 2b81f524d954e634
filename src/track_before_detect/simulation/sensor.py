"""What a sensor makes of point targets: stamps of a Gaussian point spread function, and noise."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Beyond this many standard deviations a Gaussian is below float32 rounding of its peak.
_REACH_SIGMAS = 6.0
# Moments of an exposure for each standard deviation along the streak, and for the shortest one.
_MOMENTS_PER_SIGMA = 8
_LEAST_MOMENTS = 16


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


def add_streak(frame: NDArray, x: float, y: float, sigma: float, amplitude: float,
               streak: NDArray) -> None:
    """Add a target that moves while the shutter is open, in place.

    Parameters
    ----------
    frame, x, y, sigma
        As for :func:`add_target`; the position is that in the middle of the exposure.
    amplitude : float
        Factor of the streak scaled to unit norm.
    streak : array, shape (2,)
        Way in x and y during the exposure in pixels.
    """
    length = float(np.hypot(*streak))
    if length == 0.0:
        add_target(frame, x, y, sigma, amplitude)
        return
    reach = int(np.ceil(_REACH_SIGMAS * sigma + length / 2)) + 1
    left, top = int(np.rint(x)) - reach, int(np.rint(y)) - reach
    picture = np.zeros((2 * reach + 1, 2 * reach + 1))
    n_moments = max(_LEAST_MOMENTS, int(np.ceil(_MOMENTS_PER_SIGMA * length / sigma)))
    for moment in (np.arange(n_moments) + 0.5) / n_moments - 0.5:
        add_target(picture, x - left + moment * streak[0], y - top + moment * streak[1], sigma,
                   1.0)
    picture *= amplitude / np.linalg.norm(picture)
    height, width = frame.shape
    rows = slice(max(0, top), max(0, min(height, top + len(picture))))
    columns = slice(max(0, left), max(0, min(width, left + len(picture))))
    frame[rows, columns] += picture[rows.start - top:rows.stop - top,
                                    columns.start - left:columns.stop - left]


def add_path(frames: NDArray, path: NDArray, sigma: float, amplitudes: ArrayLike,
             streaks: NDArray | None = None) -> None:
    """Add a target to each of the frames it is in, in place.

    Parameters
    ----------
    frames : array, shape (T, H, W)
    path : array, shape (T, 2)
        x and y in pixels; NaN where the target is absent.
    sigma : float
        Standard deviation of the point spread function in pixels.
    amplitudes : float or array, shape (T,)
        Factor of the unit-norm stamp, or streak.
    streaks : array, shape (T, 2), optional
        Ways during the exposures in pixels; without them the shutter is open for an instant.
    """
    streaks = np.zeros(path.shape) if streaks is None else streaks
    for frame, (x, y), amplitude, streak in zip(
            frames, path, np.broadcast_to(amplitudes, len(path)), streaks, strict=True):
        if np.isfinite(x):
            add_streak(frame, x, y, sigma, amplitude, streak)


def _profile(centre: float, sigma: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return pixel indices around ``centre`` and unit-norm samples of a Gaussian there."""
    reach = max(1, int(np.ceil(_REACH_SIGMAS * sigma)))
    pixels = np.arange(int(np.rint(centre)) - reach, int(np.rint(centre)) + reach + 1)
    samples = np.exp(-0.5 * ((pixels - centre) / sigma) ** 2)
    return pixels, samples / np.linalg.norm(samples)
