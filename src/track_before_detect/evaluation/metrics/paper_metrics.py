"""The measures that the papers on dynamic programming report.

Fu, Zhang, Luo and Gao, *Dynamic Programming Ring for Point Target Detection*, Appl. Sci. 2022, 12,
1151 (Eq. 15 and 16), and Guo, Li, Son and Fu, *Parallel Computing Based Dynamic Programming
Algorithm of Track-before-Detect*, 2018 (Section 4.3). Positions are x, y in pixels (cells); NaN
where a trajectory or target is absent.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.metrics.matching import closest_pairs, Paths

# A point within this of a target, on either axis, is the target's (Fu et al., Section 4.1).
SAME_POINT_PX = 1.0
# A target is detected by a track that ends within this of it, on either axis (Guo et al.).
SAME_END_CELLS = 2.0


def count_points(found: Paths, targets: Paths) -> tuple[int, int]:
    """Return how many points of targets are detected, and how many of trajectories are false.

    A point is one target or trajectory in one frame. The first over all points of targets is P_d
    (Eq. 15 of Fu et al.), the second over all pixels of the sequence is P_f (Eq. 16).
    """
    n_frames = len([*found, *targets][0]) if len(found) or len(targets) else 0
    estimates = np.asarray(found, float).reshape(len(found), n_frames, 2)
    truths = np.asarray(targets, float).reshape(len(targets), n_frames, 2)
    # A comparison with NaN is false: what is absent is near nothing.
    near = np.abs(estimates[:, None] - truths[None]).max(axis=3) <= SAME_POINT_PX
    present = np.isfinite(estimates).all(axis=2)
    return int(near.any(axis=0).sum()), int((present & ~near.any(axis=1)).sum())


class TrackErrors(NamedTuple):
    """Which targets were detected and how far their tracks are off.

    Attributes
    ----------
    detected : array of bool, shape (M,)
        Whether a track ends near the target; a track counts for one target at most.
    squared_errors : array, shape (M,)
        Mean squared distance, in squared cells, of the track to the cells the target was in; NaN
        for a target that was not detected.
    """

    detected: NDArray[np.bool_]
    squared_errors: NDArray[np.float64]


def track_errors(found: Paths, targets: Paths) -> TrackErrors:
    """Compare tracks with targets at the last stage, and valid tracks over all stages.

    The paper names the two quantities and gives no formula. Read here: near is within two cells
    on both axes, the nearest ends are paired first to last so that their sum is least, and the
    error is taken to the target's position rounded to cells ("the discretized trajectory").
    """
    truths = np.asarray(targets, float)
    detected = np.zeros(len(truths), bool)
    errors = np.full(len(truths), np.nan)
    if len(found) and len(truths):
        estimates = np.asarray(found, float)
        apart = np.abs(estimates[:, None, -1] - truths[None, :, -1]).max(axis=2)
        for track, target in closest_pairs(apart, apart <= SAME_END_CELLS, SAME_END_CELLS):
            detected[target] = True
            off = np.rint(truths[target]) - estimates[track]
            errors[target] = np.nanmean((off**2).sum(axis=1))
    return TrackErrors(detected, errors)
