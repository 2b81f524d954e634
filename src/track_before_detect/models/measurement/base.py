"""What a measurement model is: how the frames of a batch see a target at each position."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.measurement import CompiledMeasurement
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.motion.state_graph import StateGraph

# Which frames of a batch: a slice of them, or their numbers.
Frames = slice | NDArray[np.int64]
NOTHING = np.empty((0, 0), np.float32)
NO_FRAMES = np.empty((0, 0, 0), np.float32)
# Calls a function, told some arguments and the first and last row, for all rows of a grid.
OverRows = Callable[..., object]


class SearchWork(NamedTuple):
    """What a search of one batch has to compute, counted.

    Attributes
    ----------
    n_kinds : int
        Scores that each position has, between which the velocity chooses.
    filtered : int
        Components of the PSF that are filtered at each place, in all frames together.
    streak_places : int
        Places of streaks that are added up at each place, in all frames.
    stamp_pixels, seen_pixels : int
        Pixels of the stamps that are made at each place, and of them in all frames.
    stamps, pixels : int
        Stamps that are made when a path is looked at, of each component and moment of the
        exposure in all frames, and their pixels.
    """

    n_kinds: int
    filtered: int
    streak_places: int
    stamp_pixels: int
    seen_pixels: int
    stamps: int
    pixels: int


class Scores(ABC):
    """What each position of a grid adds to the value of a path, in frames of one size.

    Attributes
    ----------
    grid_shape : tuple of int
        (Y, X)
    kinds : array of int, shape (V,), or None
        Which of several scores is that of each velocity; None where one serves all.
    squares : array, shape (C * T, Y, X), (C, Y, X) or None
        Of constant amplitudes: n^2 of each position, one of each kind for all frames or for each;
        None where all are one.
    can_renew : bool
        Whether scores may be brought up to date in some rows alone.
    """

    grid_shape: tuple[int, int]
    kinds: NDArray[np.int64] | None = None
    squares: NDArray[np.float32] | None = None
    can_renew = False

    @abstractmethod
    def set_weights(self, weights: NDArray | None) -> None:
        """Tell one over the noise of each pixel, zero where masked.

        Parameters
        ----------
        weights : array, shape (T, H, W) or (1, H, W), or None
            None where all are one.
        """

    @abstractmethod
    def scores(self, frames: NDArray, factor: float | None = None,
               tilt: float = 0.0) -> NDArray[np.float32]:
        """Return what every position adds, shape (C * T, Y, X), all frames of a kind together.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            In units of the noise, masked pixels zero; complex where the amplitudes are.
        factor, tilt : float
            Of constant amplitudes: factor * n h - tilt * n^2, n one without weights. Unless a
            factor is given it is h over the root of the number of frames, as if n were one.
        """

    def renew(self, scores: NDArray, frames: NDArray, changed: NDArray) -> NDArray[np.bool_]:
        """Bring scores (T, Y, X) up to date after some rows of pixels have changed.

        Parameters
        ----------
        scores : array, shape (T, Y, X)
            Of the frames before; changed in place.
        frames : array, shape (T, H, W)
            The frames now.
        changed : array of bool, shape (T, H)
            Which rows of pixels differ.

        Returns
        -------
        array of bool, shape (T, Y)
            Which rows of the scores are computed anew.
        """
        raise NotImplementedError

    def restore(self, positions: NDArray, frames: NDArray) -> NDArray[np.float64]:
        """Return where positions (N, 2) of the grid are in N frames, in steps of their grid."""
        return positions


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
    def is_one_gaussian(self) -> bool:
        """Whether it is a Gaussian, the same in all frames."""

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

    def gaussian(self, width_px: float) -> MeasurementModel:
        """Return the same view of a Gaussian target of a width in pixels of the positions."""

    def scores(self, graph: StateGraph, shape: tuple[int, int], amplitudes: AmplitudeModel,
               over_rows: OverRows) -> Scores:
        """Return the scores of all positions for the paths of a graph.

        Parameters
        ----------
        graph : StateGraph
            Its step has to match the oversampling.
        shape : tuple of int
            (H, W) of the frames, or of the plane that they see.
        amplitudes : AmplitudeModel
            Says what a statistic is worth.
        over_rows : callable
            Calls a function of first and last row for all rows of the grid.
        """

    def search_work(self, graph: StateGraph, is_complex: bool) -> SearchWork:
        """Return what a search of the paths of a graph has to compute."""


def grid_shape(measurement: MeasurementModel, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the size (Y, X) of the position grid in frames of size (H, W)."""
    n_sub = measurement.oversampling
    return n_sub * (shape[0] - 1) + 1, n_sub * (shape[1] - 1) + 1


def frame_of(stack: NDArray, t: int) -> NDArray:
    """Return the entry of frame ``t`` of a stack of one for each, one for all, or none."""
    return stack[t if len(stack) > 1 else 0] if len(stack) else NOTHING
