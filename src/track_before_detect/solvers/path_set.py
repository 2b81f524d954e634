"""The working set: paths between the pixels, their amplitudes and how they overlap.

Frames are independent, so two paths meet through one number per frame, the inner product of
their stamps. With those numbers and the matched filter of the data along each path the objective
needs no pixels (Patent Eq. 6-8).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from track_before_detect.kernels import shrinkage
from track_before_detect.kernels import stamps as stamp_kernels
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.psf import Psf

# Sweeps of coordinate descent that settle the amplitudes of a scene, and those that are enough to
# see whether a change of few paths pays.
MOST_SWEEPS = 5000
FEW_SWEEPS = 60


class PathSet:
    """Paths with amplitudes and the residual they leave.

    Parameters
    ----------
    frames : float32 array, shape (T, H, W)
        Frames of unit noise, masked pixels zero.
    weights : array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel, zero where masked; of no frames where it is one.
    psf : Psf
        What a target looks like.
    threshold : float
        lambda of a path without turns.
    model : AmplitudeModel
        Of the amplitudes.

    Attributes
    ----------
    positions : list of array, shape (T, 2)
        x and y in pixels of each path, NaN where it is absent.
    costs : list of float
        Cost of the turns and of being present, which raises lambda of the path.
    settled : list of bool
        Whether a path was refined where it is, apart from all others.
    amplitudes : array, shape (P, T)
    residual : float32 array, shape (T, H, W)
        Frames less the fit.
    """

    def __init__(self, frames: NDArray, weights: NDArray, psf: Psf, threshold: float,
                 model: AmplitudeModel):
        self.model = model
        self.frames = frames
        self._pixel_weights = np.asarray(weights, np.float32)
        self._optics = psf.optics()
        self.threshold = threshold
        self.positions: list[NDArray] = []
        self.costs: list[float] = []
        self.settled: list[bool] = []
        self._stamps: list[NDArray] = []
        self._origins: list[NDArray] = []
        n_frames = len(frames)
        self.matched = np.empty((0, n_frames))
        self.gram = np.empty((0, 0, n_frames))
        self.amplitudes = np.empty((0, n_frames))
        self._touching = np.empty((0, 0), bool)
        self.residual = frames.copy()
        self.energy = 0.5 * float(np.einsum('tyx,tyx->', frames, frames, dtype=np.float64))

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weight lambda of each path, shape (P,)."""
        return np.array([self.model.weight(self.threshold, cost) for cost in self.costs], float)

    def add(self, positions: NDArray, cost: float) -> None:
        """Append a path with amplitude zero."""
        self.positions.append(positions)
        self.costs.append(cost)
        self.settled.append(False)
        stamps, origins = self._render(positions)
        self._stamps.append(stamps)
        self._origins.append(origins)
        n_paths, n_frames = len(self), len(self.frames)
        for name, shape in (('matched', (n_paths, n_frames)), ('amplitudes', (n_paths, n_frames)),
                            ('gram', (n_paths, n_paths, n_frames)),
                            ('_touching', (n_paths, n_paths))):
            old = getattr(self, name)
            grown = np.zeros(shape, old.dtype)
            grown[tuple(slice(0, n) for n in old.shape)] = old
            setattr(self, name, grown)
        self._relate(n_paths - 1)

    def move(self, path: int, positions: NDArray, cost: float) -> None:
        """Put a path elsewhere, its amplitudes unchanged."""
        self._take(path, -1.0)
        self.positions[path] = positions
        self.costs[path] = cost
        self.settled[path] = False
        self._stamps[path], self._origins[path] = self._render(positions)
        self._relate(path)
        self._take(path, 1.0)

    def remove(self, paths: NDArray) -> None:
        """Drop some paths."""
        for path in paths:
            self._take(path, -1.0)
        keep = np.setdiff1d(np.arange(len(self)), paths)
        self.positions = [self.positions[p] for p in keep]
        self.costs = [self.costs[p] for p in keep]
        self.settled = [self.settled[p] for p in keep]
        self._stamps = [self._stamps[p] for p in keep]
        self._origins = [self._origins[p] for p in keep]
        self.matched = self.matched[keep]
        self.amplitudes = self.amplitudes[keep]
        self.gram = self.gram[np.ix_(keep, keep)]
        self._touching = self._touching[np.ix_(keep, keep)]

    def fitted(self, members: NDArray, t_convex: float, tolerance: float,
               most_sweeps: int = FEW_SWEEPS) -> tuple[float, NDArray, bool]:
        """Fit the amplitudes of some paths, all others fixed.

        Returns
        -------
        objective : float
            F_t as far as it depends on these paths.
        amplitudes : array, shape (len(members), T)
        converged : bool
        """
        problem = self._problem(members)
        amplitudes = self.amplitudes[members]
        sweeps = shrinkage.descend(amplitudes, *problem, t_convex, self.model.code, tolerance,
                                   most_sweeps)
        matched, gram, _, weights = problem
        return (objective(amplitudes, matched, gram, weights, t_convex), amplitudes,
                sweeps <= most_sweeps)

    def objective_of(self, members: NDArray, t_convex: float) -> float:
        """Return F_t as far as it depends on some paths, all others fixed."""
        matched, gram, _, weights = self._problem(members)
        return objective(self.amplitudes[members], matched, gram, weights, t_convex)

    def _problem(self, members):
        """Return matched filter less the fit of all other paths, overlaps and weights."""
        others = self._touching[members].any(axis=0)
        others[members] = False
        matched = self.matched[members]
        if others.any():
            outside = np.flatnonzero(others)
            matched -= np.einsum('pqt,qt->pt', self.gram[np.ix_(members, outside)],
                                 self.amplitudes[outside])
        pairs = np.ix_(members, members)
        return matched, self.gram[pairs], self._touching[pairs], self.weights[members]

    def assign(self, members: NDArray, amplitudes: NDArray) -> None:
        """Set the amplitudes of some paths and bring the residual up to date."""
        for row, path in enumerate(members):
            change = amplitudes[row] - self.amplitudes[path]
            self.amplitudes[path] = amplitudes[row]
            # Smaller changes vanish in the single precision of the residual.
            if np.abs(change).max() > 1e-7:
                stamp_kernels.accumulate(
                    self.residual, self._stamps[path], self._origins[path], -change)

    def neighbours(self, path: int) -> NDArray[np.int64]:
        """Return the paths that overlap this one in some frame, itself included."""
        near = self._touching[path].copy()
        near[path] = True
        return np.flatnonzero(near)

    def clusters(self) -> list[NDArray[np.int64]]:
        """Return the sets of paths that overlap, directly or through others."""
        _, labels = connected_components(self._touching, directed=False)
        order = np.argsort(labels, kind='stable')
        return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if len(order) else []

    def objective(self, t_convex: float) -> float:
        """Return F_t, the energy of the data included."""
        return self.energy + objective(self.amplitudes, self.matched, self.gram, self.weights,
                                       t_convex)

    @contextmanager
    def without(self, path: int) -> Iterator[NDArray]:
        """Lend the frames less the fit of all other paths."""
        self._take(path, -1.0)
        try:
            yield self.residual
        finally:
            self._take(path, 1.0)

    def similarity(self, path: int) -> NDArray:
        """Return the mean overlap with every path while a path is present, shape (P,)."""
        present = np.count_nonzero(self.gram[path, path])
        return self.gram[path].sum(axis=1) / max(present, 1)

    def seen(self, path: int) -> NDArray:
        """Return the matched filter statistic along a path, the other paths taken off, (T,)."""
        others = np.einsum('qt,qt->t', self.gram[path], self.amplitudes)
        own = self.gram[path, path] * self.amplitudes[path]
        return self.matched[path] - others + own

    def statistic_of(self, positions: NDArray) -> float:
        """Return the statistic of any path on the residual."""
        stamps, origins = self._render(positions)
        seen = np.empty(len(self.frames))
        stamp_kernels.correlate(stamps, origins, self.residual, seen)
        return self.model.statistic(seen)

    def refresh(self) -> None:
        """Compute the residual anew, which sheds the rounding of many small changes."""
        self.residual[:] = self.frames
        for path in range(len(self)):
            self._take(path, 1.0)

    def _take(self, path, sign):
        """Take the fit of one path off the residual (or put it back)."""
        stamp_kernels.accumulate(self.residual, self._stamps[path], self._origins[path],
                                 -sign * self.amplitudes[path])

    def _render(self, positions):
        size = 2 * self._optics.half + 1
        n_frames, height, width = self.frames.shape
        stamps = np.empty((n_frames, size, size))
        origins = np.empty((n_frames, 2), np.int64)
        norms = np.empty(n_frames)
        absent = ~np.isfinite(positions[:, 0])
        there = np.where(absent[:, None], 0.0, positions)
        stamp_kernels.render(self._optics, there, height, width, self._pixel_weights, stamps,
                             origins, norms)
        stamps[absent] = 0.0
        return stamps, origins

    def _relate(self, path):
        """Fill the matched filter and the overlaps of one path."""
        stamp_kernels.correlate(self._stamps[path], self._origins[path], self.frames,
                                self.matched[path])
        for other in range(len(self)):
            stamp_kernels.overlap(self._stamps[path], self._origins[path], self._stamps[other],
                                  self._origins[other], self.gram[path, other])
            self.gram[other, path] = self.gram[path, other]
        touching = np.any(self.gram[path], axis=1)
        self._touching[path] = touching
        self._touching[:, path] = touching


def objective(amplitudes: NDArray, matched: NDArray, gram: NDArray, weights: NDArray,
              t_convex: float) -> float:
    """Return F_t without the energy of the data.

    F_t = 1/2 x'Gx - h'x + t sum w_p |x_p| + 1/2 (1 - t)^2 sum of w_p^2 over paths with x_p != 0

    Parameters
    ----------
    amplitudes, matched : array, shape (P, T)
    gram : array, shape (P, P, T)
    weights : array, shape (P,)
    t_convex : float
        t, from 1 (convex) to 0 (combinatorial).
    """
    norms = np.sqrt(np.einsum('pt,pt->p', amplitudes, amplitudes))
    fit = np.einsum('pt,pqt,qt->', amplitudes, gram, amplitudes)
    used = weights[norms > 0]
    return float(0.5 * fit - np.sum(matched * amplitudes) + t_convex * np.sum(weights * norms)
                 + 0.5 * (1 - t_convex)**2 * math.fsum(used**2))
