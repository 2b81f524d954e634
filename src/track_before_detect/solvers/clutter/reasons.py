"""Why a path that stands out is no target: where it lies, how it moves, what it looks like."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.solvers.batch_detector import FoundTrajectory

ON_BORDER, IN_ONE_FRAME = 'on the border of the frames', 'in one frame only'
SHADOW = 'shadow of a stronger one'
# Distance from the border, in widths of the PSF, within which the scene comes in and goes.
BORDER = 3.0
# Frames that a path may owe its statistic to more than in equal shares.
STRONG_FRAMES = 2
# Pixels per frame that the scene has to move for a path to be known from it, and by which the
# path may differ from it.
LEAST_MOTION_PX, SAME_MOTION_PX = 1.0, 0.3
# Length in pixels of the longest target, and how many times longer than wide an edge is.
LONGEST_PX, ELONGATED = 8.0, 2.0
# Width at half height of a target seen through its matched filter, in widths of the PSF.
HALF_HEIGHT = 2 * math.sqrt(2 * math.log(2)) * math.sqrt(2)


def reason_against(trajectory: FoundTrajectory, frames: NDArray, width_px: float,
                   scene: NDArray | None = None) -> str:
    """Return why a trajectory above the threshold is no target, or nothing.

    Parameters
    ----------
    trajectory : FoundTrajectory
        In pixels of ``frames``.
    frames : array, shape (T, H, W)
        Frames of unit noise, masked pixels zero.
    width_px : float
        Standard deviation of a target in pixels.
    scene : array, shape (T, 3, 3), optional
        How the scene moves in the frames; see :class:`FrameBatch`.
    """
    height, width = frames.shape[1:]
    last = np.array([width - 1, height - 1])
    # All of a 1-D sensor is near a border.
    margin = np.minimum(BORDER * width_px, last / 8)
    inside = np.minimum(trajectory.positions, last - trajectory.positions) - margin
    if np.nanmedian(inside.min(axis=1)) < 0:
        return ON_BORDER
    power = np.nan_to_num(np.abs(trajectory.amplitudes)) ** 2
    usual = 1 - STRONG_FRAMES / len(power)
    if trajectory.statistic ** 2 * (1 - power.max() / power.sum()) < usual:
        return IN_ONE_FRAME
    if scene is not None and _follows(trajectory.positions, scene):
        return 'follows the scene'
    if _is_edge(trajectory, frames, width_px):
        return 'edge-like'
    return ''


def is_shadow(trajectory: FoundTrajectory, stronger: FoundTrajectory, width_px: float) -> bool:
    """Return whether a trajectory runs beside a stronger one of the other sign.

    A background that is estimated around a target, or while it is there, holds some of it: where
    the target is not, too much is taken off.
    """
    distances = np.hypot(*(trajectory.positions - stronger.positions).T)
    opposite = np.nansum(trajectory.amplitudes) * np.nansum(stronger.amplitudes) < 0
    return bool(opposite and np.nanmedian(distances) < LONGEST_PX + HALF_HEIGHT * width_px)


def _follows(positions: NDArray, scene: NDArray) -> bool:
    """Return whether a path moves as the scene at its place does, which moves."""
    present = np.flatnonzero(np.isfinite(positions[:, 0]))
    middle = present[len(present) // 2]
    at = geometry.apply(geometry.inverse(scene[middle:middle + 1]), positions[middle:middle + 1])
    carried = geometry.apply(scene, np.repeat(at, len(scene), axis=0))
    return (math.hypot(*_per_frame(carried[present], present)) > LEAST_MOTION_PX
            and math.hypot(*_per_frame(positions[present] - carried[present], present))
            < SAME_MOTION_PX)


def _per_frame(positions: NDArray, frames: NDArray) -> NDArray[np.float64]:
    """Return the mean motion x, y in pixels per frame."""
    return np.polyfit(frames, positions, 1)[0] if len(frames) > 1 else np.zeros(2)


def _is_edge(trajectory: FoundTrajectory, frames: NDArray, width_px: float) -> bool:
    """Return whether what lies around a path is longer than any target, and narrow.

    The mean over the frames along the path is smoothed by the PSF; its part above half of the
    height on the path is measured by its second moments.
    """
    present = np.flatnonzero(np.isfinite(trajectory.positions[:, 0]))
    positions = trajectory.positions[present]
    # A streak is as long as the way within a frame.
    longest = (LONGEST_PX + HALF_HEIGHT * width_px
               + math.hypot(*_per_frame(positions, present)))
    reach = math.ceil(longest)
    around = _mean_around(frames[present], positions, trajectory.amplitudes[present], reach)
    seen = ndimage.gaussian_filter(around, width_px)
    beside = seen[reach - 1:reach + 2, reach - 1:reach + 2]
    row, column = np.unravel_index(int(np.argmax(beside)), beside.shape)
    parts, _ = ndimage.label(seen >= 0.5 * beside[row, column], np.ones((3, 3)))
    part = np.argwhere(parts == parts[reach - 1 + row, reach - 1 + column])
    if len(part) < 2:
        return False
    # A bar of n pixels has a variance of (n^2 - 1) / 12.
    narrow, wide = np.sqrt(12 * np.maximum(np.linalg.eigvalsh(np.cov(part.T)), 0) + 1)
    return bool(wide > longest and wide > ELONGATED * narrow)


def _mean_around(frames: NDArray, positions: NDArray, amplitudes: NDArray,
                 reach: int) -> NDArray[np.float64]:
    """Return the pixels around a path, of unit noise, as the mean of frames by amplitude."""
    offsets = np.arange(-reach, reach + 1)
    columns, rows = (np.rint(along).astype(int)[:, None] + offsets for along in positions.T)
    known = np.nan_to_num(amplitudes)
    total = np.zeros((len(offsets), len(offsets)))
    height, width = frames.shape[1:]
    for frame, x, y, amplitude in zip(frames, columns, rows, known, strict=True):
        inside = np.outer((y >= 0) & (y < height), (x >= 0) & (x < width))
        seen = frame[np.ix_(np.clip(y, 0, height - 1), np.clip(x, 0, width - 1))]
        total += np.where(inside, (np.conj(amplitude) * seen).real, 0.0)
    return total / np.linalg.norm(known)
