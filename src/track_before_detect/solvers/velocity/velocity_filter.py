"""The detector ``velocity_filter``: shift-and-stack over constant velocities.

Every position of the grid is searched over every constant velocity. The best are moved between the
grid by a least-squares fit of a straight line, so that the grid may be coarse, and compared with
the threshold; what they explain is taken off the frames, and the positions that this changes are
searched again. Nothing is fitted jointly, and no trajectory is bent.

A target keeps its amplitude and velocity over the batch; it may enter and leave the frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import logging
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.amplitude_codes import CONSTANT, SIGNED_CONSTANT
from track_before_detect.kernels.psf.gauss_newton import maximise_statistic
from track_before_detect.kernels.psf.measurement import whole_norm
from track_before_detect.kernels.psf.psf_stamps import accumulate, render, statistic_and_slope
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.velocity_grid import velocity_grid, VelocityGrid
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import usable_cores
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
    searched_speed,
)
from track_before_detect.solvers.calibration.noise_study import CROP_PX, NoiseStudy
from track_before_detect.solvers.pixel_statistics import measure
from track_before_detect.solvers.velocity.shift_and_stack import VelocityStack
from track_before_detect.solvers.watch import Watch
from track_before_detect.types import FrameBatch, Progress, Step

_LOG = logging.getLogger(__name__)

# Additions that a search may take, some seconds of one core; a wider one is cut down to fit.
MOST_ADDITIONS = 3e10
# Share of a whole batch that border and mask have to leave of a target.
LEAST_BATCH_SHARE = 0.1
# Smallest share of a statistic between the grid that the grid shows (docs/constants/solvers.md).
GRID_SHARE = 0.88
# CPU seconds of a look at noise: of a pixel of one frame and one velocity, and for each frame of
# refining all candidates (docs/constants/solvers.md).
SECONDS_PER_SUM = 2.2e-10
SECONDS_PER_FRAME = 5.2e-4
# Smallest crops of noise, and the share that the fastest target may cross of one
# (docs/constants/solvers.md).
LEAST_CROP_PX = 64
MOST_OF_CROP = 0.8
# Candidates that are refined for one look at noise, and in one round of a detection.
FEW_CANDIDATES = 8
MOST_CANDIDATES = 2000
MOST_ROUNDS = 1000
MOST_STEPS = 8
# Stamps further apart than this in widths of the PSF do not touch; a trajectory nearer to a better
# one than that in widths, on average, is what a line could not fit of it.
APART_WIDTHS = 5.0
SAME_WIDTHS = 1.5


class _Line(NamedTuple):
    """A target on a straight line: its positions (T, 2), and in which frames it is inside (T,)."""

    positions: NDArray[np.float64]
    inside: NDArray[np.bool_]
    statistic: float
    snr: float
    amplitude: float


class VelocityFilterDetector(BatchDetector):
    """Finds targets of constant amplitude and velocity, one after the other.

    Parameters
    ----------
    options : DetectorOptions
        PSF, largest speed, sign of the amplitudes and threshold.
    """

    def __init__(self, options: DetectorOptions):
        super().__init__(options)
        self.psf = psf_of(options)
        self._signed = options.amplitudes == 'signed'
        self._warned = False

    def grid(self, stamps: NDArray, shape: tuple[int, int]) -> VelocityGrid:
        """Return the velocities that are searched in frames of a shape taken at ``stamps`` (s).

        Where the search would take too much time, the fastest are left out, with a warning.
        """
        speed = float(f'{searched_speed(self.options, stamps, shape):.3g}')
        span = float(stamps[-1] - stamps[0])
        most = math.sqrt(MOST_ADDITIONS / (math.pi * shape[0] * shape[1] * len(stamps)))
        fitting = min(speed, most / span) if span > 0 else 0.0
        if fitting < speed and not self._warned:
            self._warned = True
            _LOG.warning(
                'the search for speeds up to %.3g px/s would be too large; it is made up to '
                '%.3g px/s. A lower max_speed_px_s or batch_length avoids this', speed, fitting)
        return velocity_grid(stamps, fitting)

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic of any line in noise."""
        grid = self.grid(stamps, shape)
        extent = float(np.abs(grid.axis).max() * (stamps[-1] - stamps[0]))

        def searcher(crop: tuple[int, int]) -> Callable[[np.random.Generator], float]:
            stack = self._stack(grid, crop, 1)

            def largest(generator: np.random.Generator) -> float:
                noise = generator.standard_normal((len(stamps), *crop), np.float32)
                batch = _Batch(noise, None, self.psf, stack, self._signed)
                lines = (batch.refined(*place) for place in batch.places(0.0, FEW_CANDIDATES))
                return max((line.statistic for line in lines), default=0.0)

            return largest

        return NoiseStudy(
            f'velocity_filter {grid.key} {len(stamps)} {grid.n_velocities} {self.psf.key} '
            f'{self._signed}',
            grid.effective_area, searcher,
            seconds=lambda crop: len(stamps) * (
                SECONDS_PER_SUM * grid.n_velocities * np.prod(crop) + SECONDS_PER_FRAME),
            least_crop_px=min(CROP_PX, max(LEAST_CROP_PX, round(extent / MOST_OF_CROP))),
            decay=0.5)

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories."""
        self.check_kind(batch.frames)
        frames, stamps = batch.frames, batch.stamps
        shape = frames.shape[1:]
        grid = self.grid(stamps, shape)
        threshold = self.threshold(stamps, shape, progress)
        stack = self._stack(grid, shape, usable_cores())
        return self._solve(_Batch(frames, weights, self.psf, stack, self._signed), threshold,
                           Watch(self.options.max_time_s, progress))

    def _stack(self, grid: VelocityGrid, shape: tuple[int, int],
               n_threads: int) -> VelocityStack:
        return VelocityStack(grid, shape, LEAST_BATCH_SHARE * len(grid.times), self._signed,
                             n_threads)

    def _solve(self, batch: _Batch, threshold: float, watch: Watch) -> BatchResult:
        """Take lines off the frames until none is left."""
        found: list[_Line] = []
        history = []
        status = 'iteration_limit'
        for _ in range(MOST_ROUNDS):
            largest, new = self._round(batch, threshold, found, watch)
            history.append(Step(0.0, math.nan, len(found), largest / threshold - 1))
            if not new:
                status = 'converged'
                break
            found += new
            if watch.time_is_up():
                break
            batch.subtract(new)
        found.sort(key=lambda line: -line.statistic)
        return BatchResult(
            [FoundTrajectory(line.positions,
                             np.where(line.inside, batch.whole_norm * line.amplitude, np.nan),
                             line.statistic, line.snr) for line in found],
            threshold, watch.status(status), history)

    def _round(self, batch: _Batch, threshold: float, found: list[_Line],
               watch: Watch) -> tuple[float, list[_Line]]:
        """Return the largest statistic, and lines above the threshold that are far apart."""
        largest = 0.0
        new: list[_Line] = []
        for y, x in batch.places(GRID_SHARE * threshold, MOST_CANDIDATES):
            if watch.time_is_up():
                break
            start = batch.line(y, x)
            if any(_distance(start, other).min() < APART_WIDTHS * self.psf.width_px
                   for other in new):
                continue
            line = batch.refined(y, x)
            if any(_distance(line, other).mean() < SAME_WIDTHS * self.psf.width_px
                   for other in found):
                continue
            largest = max(largest, line.statistic)
            if line.statistic > threshold:
                new.append(line)
        return largest or float(batch.stack.best.max()), new


class _Batch:
    """Frames, what is left of them, and the best velocity for each position."""

    def __init__(self, frames: NDArray, weights: NDArray | None, psf: Psf, stack: VelocityStack,
                 signed: bool):
        self._psf = psf
        self._compiled = psf.compiled(with_curvature=True)
        self._optics = self._compiled.optics[0]
        self._limits = psf.limits(frames.shape[1:])
        self.whole_norm = whole_norm(self._compiled, frames.shape[1:])
        self._model = SIGNED_CONSTANT if signed else CONSTANT
        valid = np.isfinite(frames)
        self._residual = np.ascontiguousarray(np.where(valid, frames, 0), np.float32)
        if weights is None:
            weights = np.ones((1, 1, 1), np.float32)
        # Weights, even of one, make the norm of a stamp cut by the border count as what is left.
        self._weights = np.ascontiguousarray(
            np.broadcast_to(weights * valid, frames.shape), np.float32)
        self.stack = stack
        self._measure()
        stack.run(self._psi, self._phi)

    def places(self, above: float, limit: int) -> Iterator[tuple[int, int]]:
        """Yield local maxima (y, x) of the statistic above a bound, best first."""
        best = np.pad(self.stack.best, 1, constant_values=-np.inf)
        n_y, n_x = self.stack.best.shape
        around = np.max([best[dy:dy + n_y, dx:dx + n_x] for dy in range(3) for dx in range(3)],
                        axis=0)
        y, x = np.nonzero((self.stack.best >= around) & (self.stack.best > above)
                          & (self.stack.number >= 0))
        order = np.argsort(-self.stack.best[y, x], kind='stable')[:limit]
        yield from zip(y[order].tolist(), x[order].tolist(), strict=True)

    def line(self, y: int, x: int) -> _Line:
        """Return the line through a position as the grid has it."""
        velocity = self.stack.grid.velocity(int(self.stack.number[y, x]))
        return self._line(np.array([x, y], float), velocity)

    def refined(self, y: int, x: int) -> _Line:
        """Return the line of the largest statistic near that through a position."""
        times = self.stack.grid.times
        start = self.line(y, x)
        scale = max(float(np.abs(times).max()), 1e-9)
        columns = np.stack([np.ones(len(times)), times / scale], axis=1)
        if self.stack.grid.n_velocities == 1:
            columns = columns[:, :1]
        frames = np.flatnonzero(start.inside)
        part = slice(frames[0], frames[-1] + 1)
        basis = np.zeros((part.stop - part.start, 2, 2 * columns.shape[1]))
        basis[:, 0, :columns.shape[1]] = basis[:, 1, columns.shape[1]:] = columns[part]
        moved = start.positions[part].copy()
        maximise_statistic(moved, basis, self._compiled, self._limits, self._residual[part],
                           self._weights[part], self._model, MOST_STEPS)
        fit = np.linalg.lstsq(columns[part], moved, rcond=None)[0]
        velocity = fit[1] / scale if len(fit) > 1 else np.zeros(2)
        grid = self.stack.grid
        # No further than to the next velocity.
        fastest = np.abs(grid.axis).max() + grid.step
        if np.hypot(*velocity) > fastest * (1 + 1e-9):
            return start
        line = self._line(fit[0], velocity)
        return line if line.statistic > start.statistic else start

    def _line(self, position: NDArray, velocity: NDArray) -> _Line:
        """Return a line with its statistic on what is left of the frames."""
        positions = position + self.stack.grid.times[:, None] * velocity
        n_y, n_x = self._residual.shape[1:]
        inside = np.all((positions >= -0.5) & (positions <= [n_x - 0.5, n_y - 0.5]), axis=1)
        seen, norms = np.empty((len(positions), 3)), np.empty(len(positions))
        statistic_and_slope(self._optics, positions, self._residual, self._weights, self._model,
                            seen, norms)
        h = np.where(inside, seen[:, 0], 0)
        norms = np.where(inside, norms, 0)
        total = float(norms @ norms)
        if total <= LEAST_BATCH_SHARE * len(norms):
            return _Line(positions, inside, 0.0, 0.0, 0.0)
        statistic = float(norms @ h) / math.sqrt(total)
        return _Line(positions, inside, abs(statistic) if self._model == SIGNED_CONSTANT
                     else statistic, float(h[inside].mean()), statistic / math.sqrt(total))

    def subtract(self, lines: list[_Line]) -> None:
        """Take lines off the frames, and search what they change again."""
        n_frames, n_y, n_x = self._residual.shape
        reach = self.stack.reach + 2 * self._psf.half_width + 1
        for line in lines:
            size = 2 * self._psf.half_width + 1
            stamps = np.empty((n_frames, size, size))
            origins, norms = np.empty((n_frames, 2), np.int64), np.empty(n_frames)
            render(self._optics, line.positions, n_y, n_x, self._weights, stamps, origins, norms)
            accumulate(self._residual, stamps, origins,
                       np.where(line.inside, -line.amplitude * norms, 0.0))
        self._measure()
        boxes = []
        for line in lines:
            x, y = line.positions[line.inside].T
            boxes.append((
                max(0, math.floor(y.min()) - reach), min(n_y, math.ceil(y.max()) + reach + 1),
                max(0, math.floor(x.min()) - reach), min(n_x, math.ceil(x.max()) + reach + 1)))
        if sum((bottom - top) * (right - left) for top, bottom, left, right in boxes) > n_y * n_x:
            boxes = [(0, n_y, 0, n_x)]
        for box in boxes:
            self.stack.run(self._psi, self._phi, box)

    def _measure(self) -> None:
        data = measure(self._residual, self._psf, self._weights)
        self._psi, self._phi = data.psi[0], data.phi


def _distance(line: _Line, other: _Line) -> NDArray[np.float64]:
    """Return the distance of two lines in the frames that both are in, in pixels."""
    both = line.inside & other.inside
    if not both.any():
        return np.array([np.inf])
    return np.hypot(*(line.positions - other.positions)[both].T)
