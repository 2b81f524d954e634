"""The detector ``mt_dp``: several targets by dynamic programming and target cancellation.

MT-DP-TBD as Guo et al. 2018, Section 3.1, describe it (after Yi et al. 2013). The merit of a pixel
is |h|^2, where h is the matched filter statistic, or max(h, 0)^2 for real frames; where
``amplitude_model`` is constant it is |h| or h. Amplitudes of complex frames may have any phase in
each frame.

The threshold V_DT: the paper fixes its probability of false alarm, 0.1 in its figures, and gives
no formula for V_DT. Ours is calibrated on noise like that of every other detector, so
``false_alarm_rate`` is the P_fa of a batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.kernels.psf.measurement import whole_norm
from track_before_detect.models.motion.transition_sets import directional_sets, TransitionSets
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    FoundTrajectory,
)
from track_before_detect.solvers.calibration.threshold import noise_frames, NoiseStudy
from track_before_detect.solvers.cancellation.target_cancellation import (
    MOST_TARGETS,
    Search,
    TargetSearch,
    Track,
)
from track_before_detect.solvers.pixel_statistics import exclusion_levels, measure, Merit
from track_before_detect.types import Progress, Step

MOTIONS = ('nearly_constant_velocity', 'static')


class MtDpDetector(BatchDetector):
    """Finds targets over the whole transition set, one after the other.

    Parameters
    ----------
    options : DetectorOptions
        PSF, largest speed, amplitudes and threshold.

    Raises
    ------
    ParameterError
        An option asks for a motion other than one of bounded speed.
    """

    takes_any_psf = True
    weighs_pixels = True
    n_directions = 1

    def __init__(self, options: DetectorOptions):
        super().__init__(options)
        name = options.detector
        if options.motion_model not in MOTIONS:
            raise ParameterError(
                f'{name} bounds the speed of a target and nothing else, so motion_model must be '
                f'one of {", ".join(MOTIONS)}, got {options.motion_model!r}')
        if options.max_acceleration_px_s2 is not None:
            raise ParameterError(
                f'{name} does not know the velocity of a target, so max_acceleration_px_s2 must '
                f'be automatic, got {options.max_acceleration_px_s2:g}')
        if options.presence != 'full':
            raise ParameterError(f'{name} follows a target through the whole batch, so presence '
                                 f'must be full, got {options.presence!r}')
        self.psf = psf_of(options)
        self.merit = Merit(options.amplitude_model == 'fluctuating',
                           options.amplitudes == 'signed')
        self._complex = options.amplitudes == 'complex'
        self._exclusion = exclusion_levels(self.psf)

    def transition_sets(self, stamps: NDArray) -> list[TransitionSets]:
        """Return the transition sets that are searched apart from each other."""
        steps = self.max_speed(stamps) * np.diff(stamps, prepend=stamps[0])
        # A speed that makes two pixels of an interval but for rounding makes no third.
        reaches = np.ceil(steps - 1e-6).astype(int)
        return directional_sets(reaches, self.n_directions)

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic of any path in noise."""
        directions = self.transition_sets(stamps)
        reach = max(int(np.abs(sets.rows).max()) for sets in directions)

        def searcher(crop: tuple[int, int]) -> Callable[[np.random.Generator], float]:
            def largest(generator: np.random.Generator) -> float:
                noise = noise_frames(generator, (len(stamps), *crop), self._complex)
                search = TargetSearch(measure(noise, self.psf), self._exclusion, self.merit)
                return self.merit.statistic(search.largest_merit(directions), len(stamps))

            return largest

        def area(crop: tuple[int, int]) -> float:
            return float(np.prod(np.maximum(np.array(crop) - reach, 0.5)))

        return NoiseStudy(
            f'{self.options.detector} {self.n_directions} {len(stamps)} {reach} {self.psf.key} '
            f'{self.merit} {self._complex}', area, searcher)

    def detect(self, frames: NDArray, stamps: NDArray,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories; frames may be complex where the amplitudes are."""
        return self.detect_weighted(frames, stamps, None, progress)

    def detect_weighted(self, frames: NDArray, stamps: NDArray, weights: NDArray | None,
                        progress: Progress | None = None) -> BatchResult:
        """Find the trajectories where the noise differs between pixels."""
        self.check_kind(frames)
        threshold = self.threshold(stamps, frames.shape[1:], progress)
        search = TargetSearch(measure(frames, self.psf, weights), self._exclusion, self.merit)
        return self.solve(search, self.transition_sets(stamps), threshold, len(stamps))

    def solve(self, search: TargetSearch, directions: Sequence[TransitionSets],
              threshold: float, n_frames: int) -> BatchResult:
        """Find the targets of a batch."""
        done = search.run(directions[0], self.merit.bound(threshold, n_frames))
        return self._result(search, [done], done.tracks, threshold)

    def _result(self, search: TargetSearch, searches: Sequence[Search], tracks: Sequence[Track],
                threshold: float) -> BatchResult:
        """Return tracks as trajectories, best first, with the first and last largest merit."""
        statistic, n_frames = self.merit.statistic, len(search.scores)
        visible = whole_norm(self.psf.compiled(), search.scores.shape[1:])
        found = [FoundTrajectory(
            track.pixels.astype(float), visible * search.amplitudes(track),
            statistic(track.value, n_frames),
            float(np.mean(np.abs(track.seen) if self._complex else track.seen)))
            for track in sorted(tracks, key=lambda track: -track.value)]
        left = max(search.largest_left for search in searches)
        first = max([left, *(track.value for search in searches for track in search.tracks)])
        history = [Step(0.0, math.nan, n, statistic(value, n_frames) / threshold - 1)
                   for n, value in ((0, first), (len(found), left))]
        limited = any(len(search.tracks) == MOST_TARGETS for search in searches)
        return BatchResult(found, threshold, 'iteration_limit' if limited else 'converged',
                           history, math.nan)
