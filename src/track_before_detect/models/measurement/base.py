"""What a measurement model is: how the frames of a batch see a target at each position."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.measurement import CompiledMeasurement

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

    def limits(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the largest x and y of a position for frames (H, W)."""

    def slice(self, frames: Frames) -> MeasurementModel:
        """Return the model of some of the frames."""

    def gaussian(self, width_px: float) -> MeasurementModel:
        """Return the same view of a Gaussian target of a width in pixels of the positions."""
