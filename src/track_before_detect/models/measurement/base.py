"""What a measurement model is: how the frames of a batch see a target at each position."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.measurement import CompiledMeasurement
from track_before_detect.models.motion.state_graph import StateGraph

# Which frames of a batch: a slice of them, or their numbers.
Frames = slice | NDArray[np.int64]


class MeasurementModel(Protocol):
    """How frames see the positions that are searched; see ``psf``, ``streak``, ``multi_sensor``.

    Whoever holds one asks it for what it needs, never for what it is.
    """

    @property
    def key(self) -> str:
        """Text that differs between models that differ: part of the key of calibrations."""

    @property
    def width_px(self) -> float:
        """Standard deviation of the Gaussian that is as sharp, in pixels of the positions."""

    @property
    def gaussian_sigma_px(self) -> float | None:
        """The one standard deviation of its Gaussian PSFs; None where they are no such thing."""

    @property
    def oversampling(self) -> int:
        """Grid positions per pixel that keep the loss between grid positions small."""

    def compiled(self, with_curvature: bool = False) -> CompiledMeasurement:
        """Return what compiled loops need; the curvature only to maximise the statistic."""

    @property
    def half_width(self) -> int:
        """Pixels from the centre to the edge of the largest stamp."""

    @property
    def exact_times(self) -> bool:
        """Whether it matters when exactly each frame was taken, as where sensors interleave."""

    def slice(self, frames: Frames) -> MeasurementModel:
        """Return the model of some of the frames."""

    def plane_shape(self, frame_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) of the plane of positions that frames of a size see."""

    def frame_shape(self, plane_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) of the frames that see a plane of a size."""

    def window(self, shape: tuple[int, int]) -> MeasurementModel:
        """Return the model of a part (H, W) of the plane, in its middle."""

    def limits(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the largest x and y of a position for frames (H, W)."""

    def n_kinds(self, graph: StateGraph) -> int:
        """Return how many shapes the velocities of a graph give a target."""

    def gaussian(self, width_px: float) -> MeasurementModel:
        """Return the same view of a Gaussian target of a width in pixels of the positions."""
