"""Streaks: what a target looks like that moves while the shutter is open."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.psf_profiles import Optics
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import Frames, OverRows, Scores, SearchWork
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.measurement.streak_scores import places_along, StreakScores
from track_before_detect.models.motion.state_graph import StateGraph

# Moments of the exposure for each standard deviation of the PSF along the longest streak.
NODES_PER_SIGMA = 1.0
# Standard deviations of the PSF between the streaks that are searched: half as much off at both
# ends loses two hundredths of the statistic.
SEARCHED_EACH_SIGMA = 2.0


@dataclass(frozen=True)
class StreakPsf(Psf):
    """A point spread function smeared along the velocity of the target.

    The picture is the mean over the exposure, whose middle is the stamp of the frame, scaled to
    unit norm; the velocity is that between the frames before and after.

    Attributes
    ----------
    base : Psf
        What a target at rest looks like.
    exposure : float
        Time for which the shutter is open, in units of ``times``.
    longest_px : float
        Length of the longest streak; a longer one is cut to this.
    times : tuple of float
        Time of each frame.
    """

    base: Psf
    exposure: float
    longest_px: float
    times: tuple[float, ...]

    @property
    def key(self) -> str:
        """Text that differs between PSFs that differ."""
        return f'{self.base.key} smeared for {self.exposure:.3g}'

    @property
    def half_width(self) -> int:
        """Pixels from the centre to the edge of the stamp."""
        return self.base.half_width + math.ceil(self.longest_px / 2)

    @property
    def per_px(self) -> int:
        """Spline coefficients per pixel."""
        return self.base.per_px

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """Spline coefficients of a target at rest, shape (C, 2, N)."""
        return self.base.coefficients

    @property
    def curvature(self) -> NDArray[np.float64]:  # type: ignore[override]
        """Curvature of a target at rest, see :class:`Psf`."""
        return self.base.curvature

    @property
    def gaussian_sigma_px(self) -> float | None:
        """Standard deviation of a Gaussian at rest; None of any other PSF."""
        return self.base.gaussian_sigma_px

    def slice(self, frames: Frames) -> StreakPsf:
        """Return the PSF of some frames; at their ends the velocity is one-sided."""
        return replace(self, times=tuple(np.asarray(self.times)[frames].tolist()))

    def gaussian(self, width_px: float) -> StreakPsf:
        """Return the streak of a Gaussian target of a width, or of the least width there is."""
        return replace(self, base=self.base.gaussian(width_px))

    def optics(self, curvature: NDArray | None = None) -> Optics:
        """Return what compiled loops need; the curvature only for climbing."""
        n_nodes = 2 + math.ceil(NODES_PER_SIGMA * self.longest_px / self.base.width_px)
        nodes, shares = np.polynomial.legendre.leggauss(n_nodes)
        return self.base.optics(curvature)._replace(
            half=self.half_width, nodes=nodes / 2, shares=shares / 2,
            exposure=float(self.exposure), longest_smear=float(self.longest_px),
            times=np.array(self.times))

    def scores(self, graph: StateGraph, shape: tuple[int, int], amplitudes: AmplitudeModel,
               over_rows: OverRows) -> Scores:
        """Return the scores of all positions; see ``MeasurementModel``."""
        return StreakScores(self, shape, amplitudes, over_rows, *streaks_of(graph, self))

    def search_work(self, graph: StateGraph, is_complex: bool) -> SearchWork:
        """Return what a search of the paths of a graph has to compute."""
        streaks, _ = streaks_of(graph, self)
        n_places = sum(len(places_along(streak * self.oversampling)) for streak in streaks)
        return super().search_work(graph, is_complex)._replace(
            n_kinds=len(streaks), streak_places=graph.n_frames * n_places)


def streaks_of(graph: StateGraph, psf: StreakPsf) -> tuple[NDArray, NDArray[np.int64]]:
    """Return the streaks (C, 2) in pixels that are searched, and that of each velocity (V,).

    A streak looks the same in both directions.
    """
    spacing = SEARCHED_EACH_SIGMA * psf.base.width_px
    cells = np.rint(psf.exposure * graph.velocities / spacing)
    backward = (cells[:, 1] < 0) | ((cells[:, 1] == 0) & (cells[:, 0] < 0))
    cells[backward] *= -1
    streaks, number = np.unique(cells, axis=0, return_inverse=True)
    return spacing * streaks, number.ravel()
