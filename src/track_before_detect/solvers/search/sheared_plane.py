"""The plane in which a target of constant Doppler stands still; see the module ``coupling``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.search.shear import shear_rows
from track_before_detect.kernels.search.viterbi import ABSENT
from track_before_detect.models.motion.state_graph import StateGraph


class ShearedPlane:
    """Takes the scores of maps to the sheared plane, and paths back.

    Parameters
    ----------
    graph : StateGraph
        With a coupling.
    map_shape : tuple of int
        (Y, X) of the scores of one map.

    Attributes
    ----------
    shape : tuple of int
        (Y', X): the plane has further rows at both ends, for a target whose Doppler changes would
        be elsewhere in the middle of the batch had it kept the Doppler it has at another time.
    """

    def __init__(self, graph: StateGraph, map_shape: tuple[int, int]):
        assert graph.coupling is not None
        self._shifts = graph.coupling.shifts(map_shape[1], graph.step_px)
        before = np.cumsum(np.append(0, np.abs(graph.end_moves[:-1, :, 1]).max(axis=1)))
        within = [np.abs(graph.moves[first:last, :, 1]).max()
                  for first, last in zip(graph.knots[:-1], graph.knots[1:], strict=True)]
        self._padding = min(int(np.max(before + within)), map_shape[0])
        self.shape = (map_shape[0] + 2 * self._padding, map_shape[1])

    def shear(self, scores: NDArray) -> NDArray[np.float32]:
        """Return scores (T, Y, X) as (T, Y', X); rows outside the map cannot be visited."""
        out = np.empty((len(scores), *self.shape), np.float32)
        for picture, plain, shifts in zip(out, scores, self._shifts, strict=True):
            shear_rows(picture, plain, shifts - np.int32(self._padding), ABSENT, 0,
                       self.shape[0])
        return out

    def restore(self, positions: NDArray, frames: NDArray) -> NDArray[np.float64]:
        """Return the positions (N, 2) of a path in N frames in grid steps of the maps."""
        x, y = positions.astype(int).T
        y = y - self._padding + self._shifts[frames, x]
        return np.stack([x, y], axis=1).astype(float)
