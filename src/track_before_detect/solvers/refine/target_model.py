"""How the targets of a batch move, look and vary: what is known before its frames are."""

from __future__ import annotations

import builtins
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence

# Of pixels that all weigh the same.
NO_WEIGHTS = np.zeros((0, 0, 0), np.float32)


@dataclass(frozen=True)
class TargetModel:
    """What is known of the targets of a batch.

    Attributes
    ----------
    graph : StateGraph
        Which paths there are: bounds the speed and prices the turns, on the positions of the
        measurement model.
    measurement : MeasurementModel
        What a target looks like in these frames.
    times : array, shape (T,)
        In the unit of time of the graph.
    pixel_weights : float32 array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel, zero where masked; of no frames where it is one.
    amplitudes : AmplitudeModel
        What amplitudes may be.
    presence : Presence or None
        Cost of being present; None where targets are there in every frame.
    """

    graph: StateGraph
    measurement: MeasurementModel
    times: NDArray[np.float64]
    pixel_weights: NDArray[np.float32]
    amplitudes: AmplitudeModel
    presence: Presence | None = None

    def slice(self, frames: builtins.slice) -> TargetModel:
        """Return the model of some successive frames."""
        weights = self.pixel_weights
        return replace(
            self, graph=self.graph.slice(frames), measurement=self.measurement.slice(frames),
            times=self.times[frames],
            # One row of weights may serve all frames.
            pixel_weights=weights[frames] if len(weights) > 1 else weights)
