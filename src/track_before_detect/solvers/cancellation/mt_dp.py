"""The detector ``mt_dp``: several targets by dynamic programming and target cancellation.

MT-DP-TBD as Guo et al. 2018, Section 3.1, describe it (after Yi et al. 2013). The merit of a pixel
is |h|^2, where h is the matched filter statistic, or max(h, 0)^2 for real frames; where
``amplitude_model`` is constant it is |h| or h. Amplitudes of complex frames may have any phase in
each frame.

The threshold V_DT: the paper fixes its probability of false alarm, 0.1 in its figures, and gives
no formula for V_DT. Ours is calibrated on noise like that of every other detector, so
``false_alarm_rate`` is the P_fa of a batch.
"""

from collections.abc import Callable, Sequence
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.measurement import whole_norm
from track_before_detect.models.motion.transition_sets import directional_sets, TransitionSets
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
    max_speed,
)
from track_before_detect.solvers.calibration.noise_study import noise_frames, NoiseStudy
from track_before_detect.solvers.cancellation.target_cancellation import (
    MOST_TARGETS,
    Search,
    TargetSearch,
    Track,
)
from track_before_detect.solvers.pixel_statistics import exclusion_levels, measure, Merit
from track_before_detect.types import FrameBatch, Progress, Step


class MtDpDetector(BatchDetector):
    """Finds targets over the whole transition set, one after the other.

    Parameters
    ----------
    options : DetectorOptions
        PSF, largest speed, amplitudes and threshold.
    """

    n_directions = 1

    def __init__(self, options: DetectorOptions):
        super().__init__(options)
        self.psf = psf_of(options)
        self.merit = Merit(options.amplitude_model == 'fluctuating',
                           options.amplitudes == 'signed')
        self._complex = options.amplitudes == 'complex'
        self._exclusion = exclusion_levels(self.psf)

    def transition_sets(self, stamps: NDArray) -> list[TransitionSets]:
        """Return the transition sets that are searched apart from each other."""
        return directional_sets(self._reaches(stamps), self.n_directions)

    def _reaches(self, stamps: NDArray) -> NDArray[np.int64]:
        """Return the largest step to each frame in pixels, the first of them 0."""
        steps = max_speed(self.options, stamps) * np.diff(stamps, prepend=stamps[0])
        # A speed that makes two pixels of an interval but for rounding makes no third.
        return np.ceil(steps - 1e-6).astype(int)

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic of any path in noise."""
        reaches = self._reaches(stamps)
        directions = directional_sets(reaches, self.n_directions)
        reach = int(reaches.max())
        # A number where all are alike, as kept calibrations of equal intervals have it.
        steps = reach if len(set(reaches[1:])) <= 1 else reaches.tolist()

        def searcher(crop: tuple[int, int]) -> Callable[[np.random.Generator], float]:
            def largest(generator: np.random.Generator) -> float:
                noise = noise_frames(generator, (len(stamps), *crop), self._complex)
                search = TargetSearch(measure(noise, self.psf), self._exclusion, self.merit)
                return self.merit.statistic(search.largest_merit(directions), len(stamps))

            return largest

        def area(crop: tuple[int, int]) -> float:
            return float(np.prod(np.maximum(np.array(crop) - reach, 0.5)))

        return NoiseStudy(
            f'{self.options.detector} {self.n_directions} {len(stamps)} {steps} {self.psf.key} '
            f'{self.merit} {self._complex}', area, searcher)

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories; frames may be complex where the amplitudes are."""
        frames, stamps = batch.frames, batch.stamps
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
