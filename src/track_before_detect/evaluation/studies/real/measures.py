"""How well trajectories follow the targets of a recording, and what else they follow."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.real.truth import (
    FRAME,
    HEIGHT,
    ID,
    Truth,
    WIDTH,
    X,
    Y,
)

# A trajectory follows a target that is this near, or whose box grown by the margin it is in.
NEAR_PX, BOX_MARGIN_PX = 3.0, 2.0
# A trajectory in fewer of its frames at something that is there is false.
LEAST_SHARE = 0.5
# The rule of learned detectors (Li et al., Direction-coded temporal U-shape module, 2023): a
# target is hit by a detected pixel this near to one of its pixels, along rows and columns, and a
# detected pixel is false when it is farther from all of them.
HIT_PX, FALSE_PX = 1, 4


@dataclass(frozen=True)
class RealMeasures:
    """What was measured in one recording.

    Attributes
    ----------
    n_labels : int
        Labels, one for each target and frame.
    followed : float
        Share of the labels that a trajectory follows.
    ids_per_target : float
        Trajectories that ever follow a target, false ones left out; mean over targets.
    n_false : int
        Trajectories that are at nothing that is there in more than half of their known frames.
    false_per_batch, false_per_minute : float
        Their rates; NaN where the times of the frames are not known.
    first_detection_frames : float
        Frames from the first label of a target to the first that is followed; mean over the
        targets that are.
    p_d : float
        Share of the labels with a detected pixel within 1 px of any pixel of the target.
    f_a : float
        Detected pixels more than 4 px from all targets, over all pixels of the known frames.
    rmse_px : float
        Root mean square distance from the nearest trajectory that follows.
    """

    n_labels: int
    followed: float
    ids_per_target: float
    n_false: int
    false_per_batch: float
    false_per_minute: float
    first_detection_frames: float
    p_d: float
    f_a: float
    rmse_px: float


def measure_tracks(tracks: Sequence[NDArray] | NDArray, truth: Truth, shape: tuple[int, int],
                   n_batches: int, duration_s: float) -> RealMeasures:
    """Measure the trajectories of a recording.

    Parameters
    ----------
    tracks : sequence of array, shape (T, 2)
        Positions x, y in every frame of the recording, in pixels; NaN where absent.
    truth : Truth
        What is there.
    shape : tuple of int
        Height and width of the frames.
    n_batches : int
        Batches that were searched.
    duration_s : float
        Length of the recording in seconds; NaN when not known.
    """
    n_frames, labels = len(truth.known), truth.labels
    positions = np.asarray(tracks, float).reshape(-1, n_frames, 2)
    frames = labels[:, FRAME].astype(int)
    offsets = positions[:, frames] - labels[:, [X, Y]]
    distances = np.linalg.norm(offsets, axis=2)
    near = _near(offsets, distances, labels)
    at_other = np.zeros(positions.shape[:2], bool)
    for other in truth.others:
        at_other |= other.holds(positions)
    false = _false(positions, near, frames, at_other, truth)
    followed: NDArray[np.bool_] = np.any(near, axis=0)
    ids = labels[:, ID]
    targets = np.unique(ids)
    n_ids = [near[~false][:, ids == target].any(axis=1).sum() for target in targets]
    delays = [frames[followed & (ids == target)].min() - frames[ids == target].min()
              for target in targets if followed[ids == target].any()]
    errors = np.where(near, distances, np.inf).min(axis=0, initial=np.inf)[followed]
    p_d, f_a = _pixel_rates(positions, at_other, truth, shape)
    n_false = int(false.sum())
    return RealMeasures(
        len(labels), _mean(followed), _mean(n_ids), n_false, n_false / n_batches,
        60 * n_false / duration_s, _mean(delays), p_d, f_a, float(np.sqrt(_mean(errors**2))))


def _near(offsets: NDArray, distances: NDArray, labels: NDArray) -> NDArray[np.bool_]:
    """Return which trajectory is at which label, shape (tracks, labels)."""
    half = labels[:, [WIDTH, HEIGHT]] / 2
    in_box = (half > 0).all(axis=1) & (np.abs(offsets) <= half + BOX_MARGIN_PX).all(axis=2)
    return in_box | (distances <= NEAR_PX)


def _false(positions: NDArray, near: NDArray, frames: NDArray, at_other: NDArray,
           truth: Truth) -> NDArray[np.bool_]:
    """Return which trajectories are mostly at nothing that is there."""
    right = at_other.copy()
    for label, frame in enumerate(frames):
        right[:, frame] |= near[:, label]
    judged = np.isfinite(positions[..., 0]) & (truth.known | at_other)
    return (right & judged).sum(axis=1) < LEAST_SHARE * judged.sum(axis=1)


def _pixel_rates(positions: NDArray, at_other: NDArray, truth: Truth,
                 shape: tuple[int, int]) -> tuple[float, float]:
    """Return P_d and F_a."""
    n_hit = n_false = 0
    for frame in np.flatnonzero(truth.known):
        there = np.isfinite(positions[:, frame, 0])
        detected = np.rint(positions[there, frame])
        pixels = truth.pixels[truth.pixels[:, 0] == frame]
        apart = np.abs(detected[:, None] - pixels[:, 2:]).max(axis=2)
        n_hit += len(np.unique(pixels[(apart <= HIT_PX).any(axis=0), 1]))
        far = (apart > FALSE_PX).all(axis=1) & ~at_other[there, frame]
        n_false += len(np.unique(detected[far], axis=0))
    n_labels, n_known = len(truth.labels), int(truth.known.sum())
    return (n_hit / n_labels if n_labels else float('nan'),
            n_false / (n_known * shape[0] * shape[1]) if n_known else float('nan'))


def _mean(values: Sequence | NDArray) -> float:
    return float(np.mean(values)) if len(values) else float('nan')
