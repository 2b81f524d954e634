"""The working set: paths between the pixels, their amplitudes and how they overlap.

Frames are independent, so two paths meet through one number per frame, the inner product of
their stamps. With those numbers and the matched filter of the data along each path the objective
needs no pixels (Patent Eq. 6-8).
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.compile_flags import read_only
from track_before_detect.kernels.fit.least_squares import find_blocks
from track_before_detect.kernels.psf import psf_stamps as stamp_kernels
from track_before_detect.kernels.psf.measurement import render_path, whole_norm
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.solvers.fit.amplitude_fit import fit_amplitudes, objective
from track_before_detect.solvers.watch import Watch

# Duality gap, in units of F_t, to which amplitudes are fitted: F_t is compared to 1e-3.
FIT_GAP = 1e-4
# Origin of the stamps of frames in which a path is absent.
FAR_AWAY = -10**6


class PsfStamps(NamedTuple):
    """What a target looks like in each frame.

    Attributes
    ----------
    pictures : array, shape (T, K, K)
        Of unit norm, zero where nothing is seen of the target.
    origins : array of int, shape (T, 2)
        Pixel (x, y) of ``pictures[t, 0, 0]``.
    norms : array, shape (T,)
        What weights and border leave of the norm of the whole stamp.
    """

    pictures: NDArray[np.float64]
    origins: NDArray[np.int64]
    norms: NDArray[np.float64]


@dataclass
class Source:
    """A target whose stamps are not those of the measurement model.

    Attributes
    ----------
    stamps : PsfStamps
    envelope : array, shape (T,)
        See :meth:`AmplitudeModel.envelope`.
    amplitudes : array, shape (T,)
    """

    stamps: PsfStamps
    envelope: NDArray[np.float64]
    amplitudes: NDArray


class StampRenderer:
    """Draws the stamps of paths.

    Parameters
    ----------
    measurement : MeasurementModel
        What a target looks like.
    shape : tuple of int
        (T, H, W) of the frames.
    pixel_weights : float32 array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel; of no frames where it is one.
    """

    def __init__(self, measurement: MeasurementModel, shape: tuple[int, ...],
                 pixel_weights: NDArray):
        self._measurement = measurement
        self._compiled = measurement.compiled()
        self._shape = shape
        self._pixel_weights = pixel_weights
        self._size = 2 * max(optics.half for optics in self._compiled.optics) + 1

    def render(self, positions: NDArray) -> PsfStamps:
        """Return the stamps of a path (T, 2), NaN where it is absent."""
        n_frames, height, width = self._shape
        stamps = PsfStamps(np.zeros((n_frames, self._size, self._size)),
                           np.full((n_frames, 2), FAR_AWAY), np.zeros(n_frames))
        [present] = np.nonzero(np.isfinite(positions[:, 0]))
        inside = slice(present[0], present[-1] + 1)
        compiled, weights = self._compiled, self._pixel_weights
        if len(present) < n_frames:
            compiled = self._measurement.slice(inside).compiled()
            # One row of weights may serve all frames.
            weights = weights[inside] if len(weights) > 1 else weights
        render_path(compiled, positions[inside], height, width, weights,
                    *(array[inside] for array in stamps))
        return stamps


class WorkingSet:
    """Paths with amplitudes and the residual they leave.

    Its paths are numbered from the first that is held to the last, so removing one renumbers those
    after it; the id of a path stays.

    Parameters
    ----------
    frames : float32 array, shape (T, H, W)
        Frames of unit noise, masked pixels zero.
    pixel_weights : array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel, zero where masked; of no frames where it is one.
    measurement : MeasurementModel
        What a target looks like.
    least_penalty : float
        lambda of a path without costs: with ``presence=partial`` not the threshold, for there a
        path has the cost of its presence at least.
    model : AmplitudeModel
        Of the amplitudes.
    period : int, optional
        Columns after which the frames repeat, where they do: a path that explains something in
        one of them explains it in all, though it was seen but once.

    Attributes
    ----------
    ids : list of int
        Of each path.
    positions : list of array, shape (T, 2)
        x and y in pixels of each path, NaN where it is absent.
    costs : list of float
        Cost of the turns and of being present, which raises lambda of the path.
    settled : list of bool
        Whether a path was refined where it is, apart from all others.
    penalties : array, shape (P,)
        lambda of each path.
    matched : array, shape (P, T)
        Matched filter of the data along each path.
    amplitudes : array, shape (P, T)
    work : int
        Of all fits so far: the sum of the cubes of their members, as a Newton step takes.
    """

    def __init__(self, frames: NDArray, pixel_weights: NDArray, measurement: MeasurementModel,
                 least_penalty: float, model: AmplitudeModel, period: int | None = None):
        self.model = model
        self._period = period
        # Where the columns of a stamp are found again, itself included.
        self._repeats = np.zeros((1, 2), np.int64)
        if period is not None:
            n_repeats = -(-frames.shape[2] // period)
            self._repeats = np.zeros((2 * n_repeats + 1, 2), np.int64)
            self._repeats[:, 0] = period * np.arange(-n_repeats, n_repeats + 1)
        self.frames = frames
        self._pixel_weights = np.asarray(pixel_weights, np.float32)
        self._renderer = StampRenderer(measurement, frames.shape, self._pixel_weights)
        self._whole_norm = whole_norm(measurement.compiled(), frames.shape[1:])
        self.least_penalty = least_penalty
        self.ids: list[int] = []
        self._next_id = 0
        self.positions: list[NDArray] = []
        self.costs: list[float] = []
        self.settled: list[bool] = []
        self._stamps: list[PsfStamps] = []
        n_frames = len(frames)
        number = complex if model.is_complex else float
        self.matched = np.empty((0, n_frames), number)
        self.penalties = np.empty(0)
        self._envelopes = np.empty((0, n_frames))
        self.amplitudes = np.empty((0, n_frames), number)
        # Most paths of a large scene are far apart: only the overlaps of those that meet are
        # held, one row for each pair; row 0, of zeros, stands for all others.
        self._pairs = np.empty((0, 0), np.int32)
        self._overlaps = np.zeros((64, n_frames))
        self._free_rows = list(range(63, 0, -1))
        self._sources: list[Source] = []
        self.work = 0
        # Frame by frame, so that no copy of all frames in double precision is made.
        once = frames[:, :, :period]
        parts = (once.real, once.imag) if model.is_complex else (once,)
        self.energy = 0.5 * sum(
            float(np.sum(np.square(frame, dtype=np.float64))) for part in parts for frame in part)

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def _residual(self) -> NDArray:
        # Frames that are only looked at take no second copy of themselves.
        return self.frames.copy()

    @cached_property
    def residual(self) -> NDArray:
        """Frames less the fit, to be read only."""
        return read_only(self._residual)

    def add(self, positions: NDArray, cost: float) -> int:
        """Append a path with amplitude zero; return its number."""
        stamps = self._renderer.render(positions)
        self.ids.append(self._next_id)
        self._next_id += 1
        self.positions.append(positions)
        self.costs.append(cost)
        self.settled.append(False)
        self._stamps.append(stamps)
        self._envelopes = np.concatenate([self._envelopes, self._envelope(stamps.norms)[None]])
        nothing = np.zeros((1, len(self.frames)), self.matched.dtype)
        self.matched = np.concatenate([self.matched, nothing])
        self.amplitudes = np.concatenate([self.amplitudes, nothing])
        self.penalties = np.append(self.penalties, self._penalty(stamps.norms, cost))
        self._pairs = np.pad(self._pairs, (0, 1))
        self._relate(len(self) - 1)
        return len(self) - 1

    def move(self, path: int, positions: NDArray, cost: float) -> None:
        """Put a path elsewhere, its amplitudes unchanged."""
        self._apply_fit(path, -1.0)
        stamps = self._renderer.render(positions)
        self.positions[path] = positions
        self.costs[path] = cost
        self.settled[path] = False
        self._stamps[path] = stamps
        self._envelopes[path] = self._envelope(stamps.norms)
        self.penalties[path] = self._penalty(stamps.norms, cost)
        self._relate(path)
        self._apply_fit(path, 1.0)

    def remove(self, paths: NDArray) -> None:
        """Drop some paths."""
        for path in paths:
            self._apply_fit(path, -1.0)
        keep = np.setdiff1d(np.arange(len(self)), paths)
        self.ids = [self.ids[p] for p in keep]
        self.positions = [self.positions[p] for p in keep]
        self.costs = [self.costs[p] for p in keep]
        self.settled = [self.settled[p] for p in keep]
        self._stamps = [self._stamps[p] for p in keep]
        self._envelopes = self._envelopes[keep]
        self.matched = self.matched[keep]
        self.amplitudes = self.amplitudes[keep]
        self.penalties = self.penalties[keep]
        self._release(np.unique(self._pairs[paths]))
        self._pairs = self._pairs[np.ix_(keep, keep)]

    def fitted(self, members: NDArray, t_convex: float,
               gap: float = FIT_GAP, watch: Watch | None = None,
               ) -> tuple[float, NDArray, bool]:
        """Fit the amplitudes of some paths to a duality gap, all others fixed.

        Or, of many paths, until the ``watch`` says that the time is up.

        Returns
        -------
        objective : float
            F_t as far as it depends on these paths.
        amplitudes : array, shape (len(members), T)
        converged : bool
        """
        self.work += len(members)**3
        problem = self._problem(members)
        amplitudes, converged = fit_amplitudes(self.amplitudes[members], *problem, t_convex,
                                               self.model, self.energy, gap,
                                               self._envelopes[members], watch)
        norms = self.model.norms(amplitudes, self._envelopes[members])
        return objective(amplitudes, *problem, t_convex, norms), amplitudes, converged

    def objective_of(self, members: NDArray, t_convex: float) -> float:
        """Return F_t as far as it depends on some paths, all others fixed."""
        amplitudes = self.amplitudes[members]
        norms = self.model.norms(amplitudes, self._envelopes[members])
        return objective(amplitudes, *self._problem(members), t_convex, norms)

    def _problem(self, members: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return matched filter less the fit of all other paths, overlaps and penalties."""
        pairs = self._pairs[members]
        met = pairs.any(axis=0)
        met[members] = False
        matched = self.matched[members]
        if met.any():
            others = np.flatnonzero(met)
            matched -= np.einsum('pqt,qt->pt', self._overlaps[pairs[:, others]],
                                 self.amplitudes[others])
        return matched, self._overlaps[pairs[:, members]], self.penalties[members]

    def assign(self, members: NDArray, amplitudes: NDArray) -> None:
        """Set the amplitudes of some paths and bring the residual up to date."""
        for row, path in enumerate(members):
            change = amplitudes[row] - self.amplitudes[path]
            self.amplitudes[path] = amplitudes[row]
            # Smaller changes vanish in the single precision of the residual.
            if np.abs(change).max() > 1e-7:
                self._accumulate(self._stamps[path], -change)

    def neighbours(self, path: int) -> NDArray[np.int64]:
        """Return the paths that overlap this one in some frame, itself included."""
        near = self._pairs[path] > 0
        near[path] = True
        return np.flatnonzero(near)

    def clusters(self) -> list[NDArray[np.int64]]:
        """Return the sets of paths that overlap, directly or through others."""
        order, ends = np.empty((2, len(self)), np.int64)
        n_clusters = find_blocks(self._pairs.astype(float), order, ends)
        return [np.sort(order[first:end]) for first, end in
                pairwise([0, *ends[:n_clusters]])]

    def objective(self, t_convex: float) -> float:
        """Return F_t, the energy of the data included."""
        fit = np.vdot(self.amplitudes, self.explained()).real
        norms = self.model.norms(self.amplitudes, self._envelopes)
        used = self.penalties[norms > 0]
        return float(self.energy + 0.5 * fit - np.vdot(self.amplitudes, self.matched).real
                     + t_convex * np.sum(self.penalties * norms)
                     + 0.5 * (1 - t_convex)**2 * math.fsum(used**2))

    def explained(self) -> NDArray:
        """Return the matched filter of the fit along each path, shape (P, T)."""
        first, second = np.nonzero(self._pairs)
        products = self._overlaps[self._pairs[first, second]] * self.amplitudes[second]
        total = np.zeros_like(self.amplitudes)
        if len(first):
            starts = np.flatnonzero(np.diff(first, prepend=-1))
            total[first[starts]] = np.add.reduceat(products, starts)
        return total

    @contextmanager
    def without(self, *paths: int) -> Iterator[NDArray]:
        """Show the frames less the fit of all paths but these, to be read only."""
        for path in paths:
            self._apply_fit(path, -1.0)
        try:
            yield self.residual
        finally:
            for path in paths:
                self._apply_fit(path, 1.0)

    @contextmanager
    def beside(self, sources: Sequence[Source]) -> Iterator[None]:
        """Let sources explain the frames together with the paths."""
        for source in sources:
            self._accumulate(source.stamps, -source.amplitudes)
        self._sources += sources
        try:
            yield
        finally:
            del self._sources[len(self._sources) - len(sources):]
            for source in sources:
                self._accumulate(source.stamps, source.amplitudes)

    def fit_source(self, source: Source) -> None:
        """Fit the amplitudes of a source beside the paths to what all else leaves."""
        wanted = source.amplitudes + self._seen_by(source.stamps)
        self._accumulate(source.stamps, source.amplitudes)
        source.amplitudes = self.model.best(wanted, source.envelope)
        self._accumulate(source.stamps, -source.amplitudes)

    def offsets(self, path: int, others: NDArray) -> list[NDArray[np.float64]]:
        """Return how far off others are from a path while both are present, each (N, 2).

        Where columns repeat, off the repeat that is nearest in the mean.
        """
        offsets = []
        for other in others:
            offset = self.positions[other] - self.positions[path]
            offset = offset[np.isfinite(offset[:, 0])]
            if self._period is not None:
                offset[:, 0] -= self._period * np.rint(np.mean(offset[:, 0]) / self._period)
            offsets.append(offset)
        return offsets

    def n_present(self, path: int) -> int:
        """Return in how many frames a path is present."""
        return int(np.count_nonzero(np.isfinite(self.positions[path][:, 0])))

    def similarity(self, path: int) -> NDArray:
        """Return the mean overlap with every path while a path is present, shape (P,)."""
        overlaps = self._overlaps[self._pairs[path]]
        return overlaps.sum(axis=1) / max(np.count_nonzero(overlaps[path]), 1)

    def seen(self, path: int) -> NDArray:
        """Return the matched filter statistic along a path, the other paths taken off, (T,)."""
        others = np.flatnonzero(self._pairs[path])
        others = others[others != path]
        return self.matched[path] - np.einsum(
            'qt,qt->t', self._overlaps[self._pairs[path, others]], self.amplitudes[others])

    def statistic(self, path: int, seen: NDArray | None = None,
                  model: AmplitudeModel | None = None) -> float:
        """Return the statistic of a path for what is ``seen`` (T,) along it.

        By default that is what it meets with the other paths taken off, and the model is that of
        the set.
        """
        return (model or self.model).statistic(self.seen(path) if seen is None else seen,
                                               self._envelopes[path])

    def value(self, path: int) -> float:
        """Return the value of a path beside all others: its statistic less what it costs."""
        value = self.model.value(self.statistic(path))
        if self.model.is_constant:
            return value - (float(self.penalties[path]) - self.least_penalty)
        return value - self.costs[path]

    def best(self, path: int, seen: NDArray | None = None) -> NDArray:
        """Return the amplitudes that fit best what is ``seen`` (T,) along a path, shape (T,).

        By default that is what it meets with the other paths taken off.
        """
        return self.model.best(self.seen(path) if seen is None else seen, self._envelopes[path])

    def target_amplitudes(self, path: int) -> NDArray:
        """Return the amplitudes of the target itself, of which a stamp may show a part, (T,).

        NaN in a frame that shows nothing of it: it is not there, or masked.
        """
        return self._of_target(self.amplitudes[path], self._stamps[path])

    def fit_alone(self, positions: NDArray, best: Callable[[NDArray], NDArray],
                  ) -> tuple[NDArray, NDArray]:
        """Return what the frames show of a path as if nothing were held, and of its target.

        Parameters
        ----------
        positions : array, shape (T, 2)
            Of a path that need not be held.
        best : callable
            Returns its best amplitudes for what is seen.

        Returns
        -------
        seen : array, shape (T,)
            The matched filter.
        amplitudes : array, shape (T,)
            As of :meth:`target_amplitudes`.
        """
        stamps = self._renderer.render(positions)
        seen = self._seen_by(stamps, self.frames)
        return seen, self._of_target(best(seen), stamps)

    def may_pass(self, positions: NDArray, cost: float) -> bool:
        """Return whether a path that is not held may pass its penalty once it is refined.

        On the residual, the amplitudes of those that are held fixed.
        """
        model = self.model
        return (self.excess_at(positions, cost)
                > model.grid_level(self.least_penalty) - model.value(self.least_penalty))

    def excess_at(self, positions: NDArray, cost: float) -> float:
        """Return by how much a path that is not held exceeds its penalty on the residual.

        As a value; NaN where the frames show nothing of it.
        """
        stamps = self._renderer.render(positions)
        if not stamps.norms.any():
            return float('nan')
        model = self.model
        statistic = model.statistic(self._seen_by(stamps), self._envelope(stamps.norms))
        return model.value(statistic) - model.value(self._penalty(stamps.norms, cost))

    def residual_statistic(self, path: int) -> NDArray:
        """Return the matched filter statistic of the residual along a path, shape (T,)."""
        return self._seen_by(self._stamps[path])

    def joint_parts(self, members: NDArray) -> tuple[NDArray, NDArray]:
        """Return some paths as parts of one target, all others fixed.

        Returns
        -------
        seen : array, shape (len(members), T)
            Inner products of the data with the stamps as targets of one brightness show them.
        overlaps : array, shape (len(members), len(members), T)
            Inner products of these stamps.
        """
        matched, overlaps, _ = self._problem(members)
        norms = np.array([self._stamps[path].norms for path in members])
        return norms * matched, norms[:, None] * norms * overlaps

    def refresh(self) -> None:
        """Compute the residual anew, which sheds the rounding of many small changes."""
        self._residual[:] = self.frames
        for path in range(len(self)):
            self._apply_fit(path, 1.0)
        for source in self._sources:
            self._accumulate(source.stamps, -source.amplitudes)

    def _seen_by(self, stamps: PsfStamps, frames: NDArray | None = None) -> NDArray:
        """Return what stamps see in each frame, of the residual unless told, shape (T,)."""
        seen = np.empty(len(self.frames), self.matched.dtype)
        stamp_kernels.correlate(stamps.pictures, stamps.origins,
                                self.residual if frames is None else read_only(frames), seen)
        return seen

    def _of_target(self, amplitudes: NDArray, stamps: PsfStamps) -> NDArray:
        """Return amplitudes (T,) of the target itself, NaN where stamps show nothing of it."""
        visible = stamps.norms > 0
        norms = np.where(visible, stamps.norms / self._whole_norm, 1.0)
        return np.where(visible, amplitudes / norms, np.nan)

    def _apply_fit(self, path: int, sign: float) -> None:
        """Take the fit of one path off the residual (or put it back)."""
        self._accumulate(self._stamps[path], -sign * self.amplitudes[path])

    def _accumulate(self, stamps: PsfStamps, amplitudes: NDArray) -> None:
        """Add stamps to the residual, wherever they are repeated."""
        for repeat in self._repeats:
            stamp_kernels.accumulate(self._residual, stamps.pictures, stamps.origins + repeat,
                                     amplitudes)

    def _envelope(self, norms: NDArray) -> NDArray[np.float64]:
        return self.model.envelope(self._counted(norms))

    def _penalty(self, norms: NDArray, cost: float) -> float:
        """Return lambda of a path."""
        return self.model.penalty(self.least_penalty,
                                  cost * self.model.cost_scale(self._counted(norms)))

    def _counted(self, norms: NDArray) -> NDArray[np.float64]:
        """Return n of each frame, see AmplitudeModel: one where all pixels weigh the same.

        Zero where a path is absent.
        """
        return norms if len(self._pixel_weights) else (norms > 0).astype(float)

    def _relate(self, path: int) -> None:
        """Fill the matched filter and the overlaps of one path."""
        own = self._stamps[path]
        stamp_kernels.correlate(own.pictures, own.origins, read_only(self.frames),
                                self.matched[path])
        self._release(np.unique(self._pairs[path]))
        self._pairs[path] = 0
        self._pairs[:, path] = 0
        size = own.pictures.shape[1]
        total, product = np.empty((2, len(self.frames)))
        # Of each repeat and path, by how much it is off in the frame in which it is nearest.
        origins = np.array([stamps.origins for stamps in self._stamps])
        apart = np.abs(origins - own.origins
                       + self._repeats[:, None, None]).max(axis=3).min(axis=2)
        for other in np.flatnonzero(apart.min(axis=0) < size):
            total[:] = 0.0
            for repeat in self._repeats[apart[:, other] < size]:
                stamp_kernels.overlap(own.pictures, own.origins, self._stamps[other].pictures,
                                      origins[other] + repeat, product)
                total += product
            if total.any():
                if not self._free_rows:
                    n_rows = len(self._overlaps)
                    self._overlaps = np.concatenate([self._overlaps, self._overlaps])
                    self._free_rows = list(range(2 * n_rows - 1, n_rows - 1, -1))
                row = self._free_rows.pop()
                self._overlaps[row] = total
                self._pairs[path, other] = self._pairs[other, path] = row

    def _release(self, rows: NDArray) -> None:
        """Let rows of the overlaps be used again."""
        self._free_rows += [int(row) for row in rows if row]
