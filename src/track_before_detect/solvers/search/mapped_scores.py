"""What each position of a plane adds to the value of a path, where every frame has its own map."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.scores import mapped_scores as mapped_filter
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.solvers.search.position_scores import grid_shape, OverRows


class MappedScores:
    """Scores of all positions of a plane, each from the stamp of every frame at its place there.

    Parameters
    ----------
    view : MultiSensor
        How the frames see the plane.
    model : AmplitudeModel
        Says what a statistic is worth; not one of constant amplitudes.
    over_rows : callable
        Calls a function of first and last row for all rows of the grid.
    """

    def __init__(self, view: MultiSensor, model: AmplitudeModel, over_rows: OverRows):
        self._view = view
        self._model = model
        self._over_rows = over_rows
        self._compiled = view.compiled()
        self._weights: NDArray | None = None
        maps = view.maps.reshape(len(view.maps), -1)
        _, kind = np.unique(np.column_stack([view.sensor, maps]), axis=0, return_inverse=True)
        self._alike = [np.flatnonzero(kind.ravel() == one) for one in range(kind.max() + 1)]

    def set_weights(self, weights: NDArray | None) -> None:
        """Tell one over the noise of each pixel (T, H, W), zero where masked; None: all one."""
        self._weights = weights

    def scores(self, frames: NDArray) -> NDArray:
        """Return what every position adds to the value of a path, shape (T, Y, X).

        Parameters
        ----------
        frames : float32 array, shape (T, H, W)
            In units of the noise, masked pixels zero.
        """
        scores = np.empty((len(frames), *grid_shape(self._view, self._view.shape)), np.float32)
        step_px = 1 / self._view.oversampling
        weights = self._weights
        for which in self._alike:
            sensor = self._view.sensor[which[0]]
            height, width = self._view.shapes[sensor]
            pixels = frames[which, :height, :width]
            squares = np.empty((0, 0, len(which)), np.float32)
            if weights is not None:
                own = weights[which if len(weights) > 1 else [0], :height, :width]
                if np.any(own != 1):
                    pixels = pixels * own
                    squares = _frame_last(np.broadcast_to(own**2, pixels.shape))
            self._over_rows(partial(
                self._fill, scores, which, _frame_last(pixels), squares,
                self._compiled.optics[sensor], self._compiled.maps[which[0]], step_px))
        return scores

    def _fill(self, scores, which, pixels, squares, optics, matrix, step_px, first, last):
        mapped_filter.scores_of_frames(scores, which, pixels, squares, optics, matrix, step_px,
                                       self._model.code, first, last)


def _frame_last(stack):
    """Return a stack (N, H, W) as (H, W, N), so that one stamp meets all frames at once."""
    return np.ascontiguousarray(np.moveaxis(stack, 0, -1), np.float32)
