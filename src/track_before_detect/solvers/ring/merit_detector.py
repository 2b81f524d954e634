"""The detectors of Fu et al. 2022: dynamic programming over whole pixels, with a threshold.

What is accumulated is the matched filter statistic of each pixel, the pixel itself when the point
spread function is one pixel wide. Algorithm 2 is told the number of targets; here its rounds go on
until one finds no trajectory whose statistic passes the threshold. That statistic is the sum of
what is accumulated along the trajectory, over the root of the number of frames.
"""

from collections.abc import Callable, Iterator
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.velocity_candidates import (
    FASTEST_SECOND_ORDER,
    straight_lines,
)
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import usable_cores
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
    max_speed,
)
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.pixel_statistics import measure
from track_before_detect.solvers.ring.crossings import with_crossings_resolved
from track_before_detect.solvers.ring.linking import LinkedTrajectory
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.solvers.ring.several_targets import found_one_by_one
from track_before_detect.solvers.watch import Watch
from track_before_detect.timestamps import median_interval
from track_before_detect.types import FrameBatch, Progress

# Part of a median interval by which a frame may come early or late.
LARGEST_JITTER = 0.25
# Rounds of one batch: every round takes what it found out of the frames, but what it leaves of an
# extremely bright target could be followed for long.
MOST_ROUNDS = 1000
# Standard deviations of the PSF from a found trajectory up to which the frames are filled
# (docs/constants/solvers.md).
FILLED_SIGMAS = 3
# CPU seconds of a look at noise: of a pixel of one frame, and of each line that a method of second
# order tries there; the ring forms take more (docs/constants/solvers.md).
SECONDS_PER_PIXEL = 3.5e-8
SECONDS_PER_LINE = 9e-10
RING_PASSES = 1.7


class MeritDetector(BatchDetector):
    """Finds trajectories at the maxima of a merit function, one after the other.

    The method is the one named by ``detector``. The amplitudes are summed as they are, so
    ``amplitude_model`` makes no difference.

    Parameters
    ----------
    options : DetectorOptions
        Method, maximum speed, PSF and threshold.
    """

    def __init__(self, options: DetectorOptions):
        super().__init__(options)
        self._method = METHODS[options.detector]
        self._psf = GaussianPsf(options.psf_sigma_px)
        self._fill_radius = max(1, math.ceil(FILLED_SIGMAS * self._psf.width_px))

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic in noise.

        Each round follows one maximum in each frame, wherever it is, so false trajectories are not
        in proportion to the area: their number is taken to grow as its root
        (docs/constants/solvers.md).
        """
        n_frames, v_max = len(stamps), self._v_max(stamps, shape)
        # Velocities of the first order are searched axis by axis, in no time.
        n_lines = 0 if self._method.order == 'cfo' else len(straight_lines(v_max))
        seconds_per_pixel = (SECONDS_PER_PIXEL + SECONDS_PER_LINE * n_lines
                             * (RING_PASSES if self._method.ring else 1.0))

        def searcher(crop: tuple[int, int]) -> Callable[[np.random.Generator], float]:
            def largest(generator: np.random.Generator) -> float:
                noise = generator.standard_normal((n_frames, *crop), dtype=np.float32)
                rounds = self._rounds(noise, v_max, 1)
                return max((_statistic(seen) for _, seen in itertools.islice(rounds, 1)),
                           default=0.0)

            return largest

        return NoiseStudy(f'{self._method.name} {v_max} {n_frames} {self._psf.key}',
                          lambda size: math.sqrt(size[0] * size[1]), searcher,
                          seconds=lambda crop: seconds_per_pixel * n_frames * crop[0] * crop[1])

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories.

        A frame that was dropped is put in as one that is masked.

        Raises
        ------
        DataError
            Complex frames, too small or too few of them, or stamps that do not come at equal
            intervals.
        """
        frames, stamps = batch.frames, batch.stamps
        places = self._places(frames, stamps)
        shape = frames.shape[1:]
        threshold = self.threshold(stamps, shape, progress)
        regular = np.full((places[-1] + 1, *shape), np.nan, np.float32)
        regular[places] = frames
        rounds = self._rounds(regular, self._v_max(stamps, shape), usable_cores())
        found: list[NDArray] = []
        status = 'iteration_limit'
        watch = Watch(self.options.max_time_s, progress)
        for trajectory, seen in itertools.islice(rounds, MOST_ROUNDS):
            if not _statistic(seen[places]) > threshold:
                status = 'converged'
                break
            found.append(np.column_stack([trajectory.positions, seen])[places])
            if watch.time_is_up():
                break
        else:
            if len(found) < MOST_ROUNDS:
                status = 'converged'
        kept = [FoundTrajectory(rows[:, :2], rows[:, 2], _statistic(rows[:, 2]),
                                float(np.nanmean(rows[:, 2])))
                for rows in with_crossings_resolved(found) if _statistic(rows[:, 2]) > threshold]
        kept.sort(key=lambda one: -one.statistic)
        return BatchResult(kept, threshold, watch.status(status), [])

    def _rounds(self, frames: NDArray, v_max: int,
                n_threads: int) -> Iterator[tuple[LinkedTrajectory, NDArray[np.float64]]]:
        return found_one_by_one(frames, self._method.name, v_max, self.statistics,
                                self._fill_radius, n_threads)

    def _v_max(self, stamps: NDArray, shape: tuple[int, int]) -> int:
        """Return the largest velocity in whole pixels per frame interval."""
        name = self._method.name
        # What rounding adds to a whole number is not a pixel more.
        per_frame = max_speed(self.options, stamps) * median_interval(stamps)
        v_max = math.ceil(min(per_frame, max(shape)) - 1e-6)
        if self._method.order != 'cfo' and v_max > FASTEST_SECOND_ORDER:
            raise ParameterError(
                f'{name} searches up to {FASTEST_SECOND_ORDER} pixels per frame interval, and '
                f'max_speed_px_s is {per_frame:.3g} pixels per interval')
        return v_max

    def _places(self, frames: NDArray, stamps: NDArray) -> NDArray[np.int64]:
        """Return the number of each frame when dropped ones are counted, shape (T,)."""
        name = self._method.name
        self.check_kind(frames)
        side = 2 * self._fill_radius + 1
        if min(frames.shape[1:]) < side:
            raise DataError(
                f'{name} takes targets out by medians of {side} x {side} pixels, so frames must '
                f'be as large, got {frames.shape[2]} x {frames.shape[1]}')
        fewest = max(self._method.fewest_frames, 2)
        if len(frames) < fewest:
            raise DataError(f'{name} needs at least {fewest} frames, got {len(frames)}')
        intervals = np.diff(stamps) / median_interval(stamps)
        steps = np.rint(intervals)
        uneven = np.flatnonzero((np.abs(intervals - steps) > LARGEST_JITTER) | (steps < 1))
        if len(uneven):
            raise DataError(
                f'{name} needs frames at equal intervals, apart from dropped ones, got '
                f'{intervals[uneven[0]]:.3g} median intervals before frame {uneven[0] + 1}')
        if steps.sum() > 2 * len(frames):
            raise DataError(f'{name} needs most frames of a batch, got {len(frames)} of '
                            f'{int(steps.sum()) + 1}')
        return np.append(0, np.cumsum(steps)).astype(int)

    def statistics(self, frames: NDArray) -> NDArray[np.float32]:
        """Return the matched filter statistic of every pixel, 0 where all of it is masked.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            Frames of unit noise; NaN where masked.
        """
        measured = measure(frames, self._psf)
        seen = measured.phi > LEAST_SHARE
        return np.where(seen, measured.psi[0] / np.sqrt(np.where(seen, measured.phi, 1)), 0)


def _statistic(seen: NDArray) -> float:
    """Return the sum of what is seen (T,) along a trajectory over the root of T."""
    return max(float(np.nansum(seen)), 0.0) / math.sqrt(len(seen))
