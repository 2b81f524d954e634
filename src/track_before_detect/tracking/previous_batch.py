"""What goes on from batch to batch: who is who, where targets were, and what was said."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.solvers.batch_detector import EarlierPaths
from track_before_detect.tracking.remarks import Remarks
from track_before_detect.tracking.stitcher import Stitcher
from track_before_detect.types import Trajectory


class PreviousBatches:
    """What a pipeline knows when a batch comes.

    Parameters
    ----------
    width_px : float
        Of the point spread function.
    earlier : PreviousBatches, optional
        Those of a pipeline before, whose identities go on.

    Attributes
    ----------
    stitcher : Stitcher
        Says who is who.
    remarks : Remarks
        What was said.
    """

    def __init__(self, width_px: float, earlier: PreviousBatches | None):
        self.stitcher: Stitcher = earlier.stitcher if earlier else Stitcher(width_px)
        self.forget_targets()

    def forget_targets(self) -> None:
        """Forget where targets were and what was said, but not who is who."""
        self.remarks = Remarks()
        self._targets: list[Trajectory] = []

    def begin_afresh(self) -> None:
        """Forget where targets were."""
        self._targets = []

    def reset(self) -> None:
        """Forget everything."""
        self.stitcher.reset()
        self.forget_targets()

    def paths(self, frame_indices: NDArray, maps: NDArray) -> EarlierPaths | None:
        """Return where targets were in a batch; see :func:`map_previous_batch`."""
        return map_previous_batch(self._targets, frame_indices, maps)

    def link(self, found: list[Trajectory], period_px: float | None = None,
             weaker: Sequence[Trajectory] = ()) -> list[Trajectory]:
        """Return the trajectories of the next batch with their ids; see :meth:`Stitcher.link`."""
        self._targets = self.stitcher.link(found, period_px, weaker)
        return list(self._targets)


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
    EarlierPaths or None
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
