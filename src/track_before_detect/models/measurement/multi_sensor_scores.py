"""What each position of a plane adds to the value of a path, where every frame has its own map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.kernels.scores.mapped_scores import scores_of_frames
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import grid_shape, OverRows, Scores

if TYPE_CHECKING:
    from track_before_detect.models.measurement.multi_sensor import MultiSensor


class MultiSensorScores(Scores):
    """Scores of all positions of a plane, each from the stamp of every frame at its place there.

    Parameters
    ----------
    view : MultiSensor
        How the frames see the plane.
    amplitudes, over_rows
        As for ``MeasurementModel.scores``.

    Raises
    ------
    ParameterError
        Amplitudes are to be constant.
    """

    def __init__(self, view: MultiSensor, amplitudes: AmplitudeModel, over_rows: OverRows):
        if amplitudes.is_constant:
            raise ParameterError(
                'amplitude_model must be fluctuating for several sensors, got constant: what is '
                'constant in the units of one sensor is not in those of another')
        self.grid_shape = grid_shape(view, view.shape)
        self._view = view
        self._model = amplitudes
        self._over_rows = over_rows
        self._compiled = view.compiled()
        self._weights: NDArray | None = None
        maps = view.maps.reshape(len(view.maps), -1)
        _, kind = np.unique(np.column_stack([view.sensor, maps]), axis=0, return_inverse=True)
        self._alike = [np.flatnonzero(kind.ravel() == one) for one in range(kind.max() + 1)]

    def set_weights(self, weights: NDArray | None) -> None:
        """Tell one over the noise of each pixel; see :class:`Scores`."""
        self._weights = weights

    def scores(self, frames: NDArray, factor: float | None = None,
               tilt: float = 0.0) -> NDArray[np.float32]:
        """Return what every position adds to the value of a path, shape (T, Y, X)."""
        scores = np.empty((len(frames), *self.grid_shape), np.float32)
        weights = self._weights
        for which in self._alike:
            sensor = self._view.sensor[which[0]]
            height, width = self._view.shapes[sensor]
            pixels = frames[which, :height, :width]
            imaginary = squares = np.empty((0, 0, len(which)), np.float32)
            if weights is not None:
                own = weights[which if len(weights) > 1 else [0], :height, :width]
                if np.any(own != 1):
                    pixels = pixels * own
                    squares = _frame_last(np.broadcast_to(own**2, pixels.shape))
            if np.iscomplexobj(pixels):
                imaginary = _frame_last(pixels.imag)
            self._over_rows(
                scores_of_frames, scores, which, _frame_last(pixels.real), imaginary, squares,
                self._compiled.optics[sensor], self._compiled.maps[which[0]],
                1 / self._view.oversampling, self._model.code)
        return scores


def _frame_last(stack: NDArray) -> NDArray[np.float32]:
    """Return a stack (N, H, W) as (H, W, N), so that one stamp meets all frames at once."""
    return np.ascontiguousarray(np.moveaxis(stack, 0, -1), np.float32)
