"""One target with a shape of its own, the same in every frame.

A target that does not look as the PSF says is taken as

    a_t sum_k c_k g_k(x - x_t),    g_k concentric Gaussians around its path x_t,

with path, widths and shares c_k fitted to all frames. That explains a target of any round shape.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from track_before_detect.kernels.psf import psf_stamps as stamp_kernels
from track_before_detect.kernels.psf.measurement import render_path
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.psf import GaussianPsf, LEAST_SIGMA_PX
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.refine.refinement import Refiner

# Widths of a target that are tried, over that of the PSF.
WIDTHS = (0.5, 3.0)
# Widths of the Gaussians of its shape over its own. In frames of one row three of them would look
# like a pair of targets as well.
SHAPE = (0.7, 1.0, 1.4)
SHAPE_ON_A_LINE = (1.0,)
# Times that width and path are fitted in turn.
ROUNDS = 2
# Energy of a sum of parts that is left to rounding.
ROUNDING = 1e-6


@dataclass
class ExtendedTarget:
    """One target with a shape of its own.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y in pixels.
    cost : float
        Of the turns of its path.
    width_px : float
        Standard deviation of the one Gaussian that explains most.
    n_shares : int
        Gaussians of the shape.
    stamps : array, shape (T, K, K)
        Of unit norm.
    origins : array, shape (T, 2)
        Pixel (x, y) of ``stamps[t, 0, 0]``.
    envelope : array, shape (T,)
        See :meth:`AmplitudeModel.envelope`.
    amplitudes : array, shape (T,)
    energy : float
        What it takes off half the squared norm of the frames that it was fitted to.
    """

    positions: NDArray[np.float64]
    cost: float
    width_px: float
    n_shares: int
    stamps: NDArray[np.float64]
    origins: NDArray[np.int64]
    envelope: NDArray[np.float64]
    amplitudes: NDArray
    energy: float

    def show(self, frames: NDArray, sign: float) -> None:
        """Add the target to frames, or take it off."""
        stamp_kernels.accumulate(frames, self.stamps, self.origins, sign * self.amplitudes)

    def fit(self, residual: NDArray, model: AmplitudeModel) -> None:
        """Fit the amplitudes again to a residual, and bring that up to date."""
        seen = np.empty_like(self.amplitudes)
        stamp_kernels.correlate(self.stamps, self.origins, residual, seen)
        self.show(residual, 1.0)
        self.amplitudes = model.best(self.amplitudes + seen, self.envelope)
        self.show(residual, -1.0)


class ExtendedTargetFitter:
    """Fits one target with a shape of its own.

    Parameters
    ----------
    graph : StateGraph
        Bounds the speed and prices the turns.
    times : array, shape (T,)
        In the unit of time of the graph.
    weights : float32 array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel; of no frames where it is one.
    model : AmplitudeModel
        Of the amplitudes.
    width_px : float
        Width of the PSF.
    """

    def __init__(self, graph: StateGraph, times: NDArray, weights: NDArray,
                 model: AmplitudeModel, width_px: float):
        self._graph = graph
        self._times = times
        self._weights = weights
        self._model = model
        self._ends = [math.log(max(factor * width_px, LEAST_SIGMA_PX)) for factor in WIDTHS]

    def fit(self, frames: NDArray, positions: NDArray, cost: float,
            threshold: float) -> ExtendedTarget:
        """Return the target that explains most of frames (T, H, W).

        Parameters
        ----------
        frames : array, shape (T, H, W)
            Without all other targets.
        positions : array, shape (T, 2)
            Path to begin with.
        cost : float
            Of its turns.
        threshold : float
            lambda of a path without turns.
        """
        model = self._model
        for _ in range(ROUNDS):
            width = self._width(frames, positions)
            refiner = Refiner(self._graph, GaussianPsf(width), self._times, self._weights, model)
            positions, cost = refiner.refine(frames, positions, cost, threshold, 0.0)
        factors = SHAPE if min(frames.shape[1:]) > 1 else SHAPE_ON_A_LINE
        parts, origins = self._parts(
            frames, positions, [max(factor * width, LEAST_SIGMA_PX) for factor in factors])
        seen = np.empty((len(parts), len(frames)), complex if model.is_complex else float)
        for part, row in zip(parts, seen, strict=True):
            stamp_kernels.correlate(part, origins, frames, row)
        overlaps = np.einsum('ityx,jtyx->ijt', parts, parts)
        mixture, seen, envelope = together(seen, overlaps, model)
        return ExtendedTarget(positions, cost, width, len(parts),
                    np.einsum('it,ityx->tyx', mixture, parts), origins, envelope,
                    model.best(seen, envelope), 0.5 * model.statistic(seen, envelope)**2)

    def _width(self, frames, positions):
        """Return the width of the Gaussian that explains most along a path."""

        def missed(log_width):
            stamps, origins, norms = self._render(frames, positions, math.exp(log_width))
            seen = np.empty(len(frames), complex if self._model.is_complex else float)
            stamp_kernels.correlate(stamps, origins, frames, seen)
            return -self._model.statistic(seen, self._model.envelope(norms))

        return math.exp(minimize_scalar(missed, bounds=self._ends, method='bounded',
                                        options={'xatol': 0.02}).x)

    def _parts(self, frames, positions, widths):
        """Return stamps (N, T, K, K) of one brightness, and where they are."""
        rendered = [self._render(frames, positions, width) for width in widths]
        size = max(stamps.shape[1] for stamps, _, _ in rendered)
        parts = []
        for stamps, _, norms in rendered:
            margin = 2 * [(size - stamps.shape[1]) // 2]
            parts.append(np.pad(norms[:, None, None] * stamps, ((0, 0), margin, margin)))
        widest = max(rendered, key=lambda one: one[0].shape[1])
        return np.array(parts), widest[1]

    def _render(self, frames, positions, width_px):
        psf = GaussianPsf(width_px)
        n_frames, height, width = frames.shape
        size = 2 * psf.half_width + 1
        stamps = np.empty((n_frames, size, size))
        origins = np.empty((n_frames, 2), np.int64)
        norms = np.empty(n_frames)
        render_path(psf.compiled(), positions, height, width, self._weights, stamps, origins,
                    norms)
        return stamps, origins, norms


def together(seen: NDArray, overlaps: NDArray, model: AmplitudeModel,
             ) -> tuple[NDArray, NDArray, NDArray]:
    """Let parts of one target vary together, in the proportion that explains most.

    Parameters
    ----------
    seen : array, shape (N, T)
        Matched filter of each part.
    overlaps : array, shape (N, N, T)
        Inner products of the parts.
    model : AmplitudeModel
        Of the amplitude that they have in common.

    Returns
    -------
    mixture : array, shape (N, T)
        Share of each part in a stamp of unit norm.
    seen : array, shape (T,)
        Matched filter of that stamp.
    envelope : array, shape (T,)
        See :meth:`AmplitudeModel.envelope`.
    """
    coherent = model.is_constant and not model.has_one_modulus
    summed = seen.sum(axis=1, keepdims=True) if coherent else seen
    energy = overlaps.sum(axis=2)
    energy += ROUNDING * np.trace(energy) * np.eye(len(energy))
    shares = eigh((summed @ summed.conj().T).real, energy)[1][:, -1]
    if (shares @ seen).real.sum() < 0:
        shares = -shares
    norms = np.sqrt(np.maximum(np.einsum('i,ijt,j->t', shares, overlaps, shares), 0.0))
    mixture = np.divide(shares[:, None], norms, out=np.zeros(seen.shape), where=norms > 0)
    return mixture, np.einsum('it,it->t', mixture, seen), model.envelope(norms)
