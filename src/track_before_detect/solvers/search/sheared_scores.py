"""Scores on the plane in which a target of constant Doppler stands still; see ``coupling``."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT
from track_before_detect.kernels.search.shear import shear_rows
from track_before_detect.models.measurement.base import Scores
from track_before_detect.models.motion.state_graph import StateGraph


class ShearedScores(Scores):
    """Takes the scores of maps to the sheared plane, and positions back.

    Parameters
    ----------
    scores : Scores
        Of the maps.
    graph : StateGraph
        With a coupling.

    Attributes
    ----------
    grid_shape : tuple of int
        (Y', X), see :func:`sheared_shape`.
    """

    def __init__(self, scores: Scores, graph: StateGraph):
        self._plain = scores
        assert graph.coupling is not None
        self._shifts = graph.coupling.shifts(scores.grid_shape[1], graph.step_px)
        self.grid_shape = sheared_shape(graph, scores.grid_shape)
        self._padding = (self.grid_shape[0] - scores.grid_shape[0]) // 2
        self.kinds = scores.kinds

    def set_weights(self, weights: NDArray | None) -> None:
        """Tell one over the noise of each pixel; see :class:`Scores`."""
        self._plain.set_weights(weights)
        self.squares = self._plain.squares

    def scores(self, frames: NDArray, factor: float | None = None,
               tilt: float = 0.0) -> NDArray[np.float32]:
        """Return scores (C * T, Y', X); rows outside the map cannot be visited."""
        plain = self._plain.scores(frames, factor, tilt)
        out = np.empty((len(plain), *self.grid_shape), np.float32)
        for number, (sheared, picture) in enumerate(zip(out, plain, strict=True)):
            shifts = self._shifts[number % len(frames)] - np.int32(self._padding)
            shear_rows(sheared, picture, shifts, ABSENT, 0, self.grid_shape[0])
        return out

    def restore(self, positions: NDArray, frames: NDArray) -> NDArray[np.float64]:
        """Return where positions (N, 2) of the plane are in the maps of N frames."""
        x, y = positions.astype(int).T
        y = y - self._padding + self._shifts[frames, x]
        return np.stack([x, y], axis=1).astype(float)


def sheared_shape(graph: StateGraph, grid_shape: tuple[int, int]) -> tuple[int, int]:
    """Return the size (Y', X) of the grid that is searched for a grid (Y, X) of positions.

    The sheared plane has further rows at both ends, for a target whose Doppler changes would be
    elsewhere in the middle of the batch had it kept the Doppler it has at another time. Without a
    coupling the grid is that of the positions.
    """
    if graph.coupling is None:
        return grid_shape
    before = np.cumsum(np.append(0, np.abs(graph.end_moves[:-1, :, 1]).max(axis=1)))
    within = [np.abs(graph.moves[first:last, :, 1]).max()
              for first, last in zip(graph.knots[:-1], graph.knots[1:], strict=True)]
    padding = min(int(np.max(before + within)), grid_shape[0])
    return grid_shape[0] + 2 * padding, grid_shape[1]
