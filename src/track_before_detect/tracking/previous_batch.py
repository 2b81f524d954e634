"""What the batch before found in the frames that a batch holds again."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.solvers.batch_detector import EarlierPaths
from track_before_detect.types import Trajectory


def map_previous_batch(before: list[Trajectory], frame_indices: NDArray,
                 maps: NDArray) -> EarlierPaths | None:
    """Return where the targets of the batch before are on the plane of this one.

    Parameters
    ----------
    before : list of Trajectory
        Of the batch before, the strongest first.
    frame_indices : array of int, shape (T,)
        Number of each frame of this batch in the recording.
    maps : array, shape (T, 3, 3)
        Takes the plane of this batch to the positions of trajectories, see ``geometry``.

    Returns
    -------
    Earlier or None
        None where the batches share no frame, or nothing was found.
    """
    if not before:
        return None
    _, old, common = np.intersect1d(before[0].frame_indices, frame_indices, return_indices=True)
    if not len(common):
        return None
    back = geometry.inverse(maps[common])
    known = np.zeros(len(frame_indices), bool)
    known[common] = True
    positions = []
    for trajectory in before:
        here = np.full((len(frame_indices), 2), np.nan)
        here[common] = geometry.apply(back, trajectory.positions[old])
        positions.append(here)
    return EarlierPaths(positions, known)
