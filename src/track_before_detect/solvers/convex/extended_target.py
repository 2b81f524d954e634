"""One target with a shape of its own, the same in every frame.

A target that does not look as the PSF says is taken as

    a_t sum_k c_k g_k(x - x_t),    g_k concentric Gaussians around its path x_t,

with path, widths and shares c_k fitted to all frames. That explains a target of any round shape.
"""

from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from track_before_detect.kernels.compile_flags import read_only
from track_before_detect.kernels.psf import psf_stamps as stamp_kernels
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.solvers.fit.working_set import PsfStamps, Source, StampRenderer
from track_before_detect.solvers.refine.refinement import refiner_for
from track_before_detect.solvers.refine.target_model import TargetModel

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


@dataclass(frozen=True)
class ExtendedTarget:
    """One target with a shape of its own.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y in pixels, NaN where it is absent.
    cost : float
        Of the turns of its path and of being present.
    width_px : float
        Standard deviation of the one Gaussian that explains most; the shape has ``n_shares``.
    source : Source
        Its stamps and amplitudes.
    energy : float
        What it takes off half the squared norm of the frames that it was fitted to.
    """

    positions: NDArray[np.float64]
    cost: float
    width_px: float
    n_shares: int
    source: Source
    energy: float


class ExtendedTargetFitter:
    """Fits one target with a shape of its own, which else is like those of a model."""

    def __init__(self, targets: TargetModel):
        self._targets = targets
        self._model = targets.amplitudes

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
            Of its turns and of being present.
        threshold : float
            lambda of a path without any cost.
        """
        model = self._model
        for _ in range(ROUNDS):
            width = self._width(frames, positions)
            refiner = refiner_for(self._of_width(width))
            positions, cost = (refiner.refine(frames, positions, cost, threshold, 0.0)
                               or (positions, cost))
        factors = SHAPE if min(frames.shape[1:]) > 1 else SHAPE_ON_A_LINE
        parts, origins = self._parts(frames, positions, [factor * width for factor in factors])
        seen = np.array([self._seen(frames, part, origins) for part in parts])
        overlaps = np.einsum('ityx,jtyx->ijt', parts, parts)
        mixture, seen, envelope = together(seen, overlaps, model)
        stamps = PsfStamps(np.einsum('it,ityx->tyx', mixture, parts), origins, envelope)
        return ExtendedTarget(positions, cost, width, len(parts),
                              Source(stamps, envelope, model.best(seen, envelope)),
                              0.5 * model.statistic(seen, envelope)**2)

    def _of_width(self, width_px: float) -> TargetModel:
        return replace(self._targets, measurement=self._targets.measurement.gaussian(width_px))

    def _width(self, frames: NDArray, positions: NDArray) -> float:
        """Return the width of the Gaussian that explains most along a path."""

        def missed(log_width: float) -> float:
            stamps = self._render(frames, positions, math.exp(log_width))
            seen = self._seen(frames, stamps.pictures, stamps.origins)
            return -self._model.statistic(seen, self._model.envelope(stamps.norms))

        ends = [math.log(factor * self._targets.measurement.width_px) for factor in WIDTHS]
        return math.exp(minimize_scalar(missed, bounds=ends, method='bounded',
                                        options={'xatol': 0.02}).x)

    def _seen(self, frames: NDArray, pictures: NDArray, origins: NDArray) -> NDArray:
        seen = np.empty(len(frames), complex if self._model.is_complex else float)
        stamp_kernels.correlate(pictures, origins, read_only(frames), seen)
        return seen

    def _parts(self, frames: NDArray, positions: NDArray, widths: list[float],
               ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return stamps (N, T, K, K) of one brightness, and where they are, (T, 2)."""
        rendered = [self._render(frames, positions, width) for width in widths]
        origins = np.min([stamps.origins for stamps in rendered], axis=0)
        # How far within the common stamp each begins; sensors have stamps of their own sizes.
        begins = [stamps.origins - origins for stamps in rendered]
        size = max(stamps.pictures.shape[1] + int(begin.max())
                   for stamps, begin in zip(rendered, begins, strict=True))
        parts = np.zeros((len(rendered), len(frames), size, size))
        for part, stamps, begin in zip(parts, rendered, begins, strict=True):
            own = stamps.pictures.shape[1]
            for t, (x, y) in enumerate(begin):
                part[t, y:y + own, x:x + own] = stamps.norms[t] * stamps.pictures[t]
        return parts, origins

    def _render(self, frames: NDArray, positions: NDArray, width_px: float) -> PsfStamps:
        return StampRenderer(self._of_width(width_px).measurement, frames.shape,
                             self._targets.pixel_weights).render(positions)


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
