"""The convex detector on one batch of prepared frames."""

from __future__ import annotations

from collections.abc import Callable
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.streak import StreakPsf
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.convex.duplicates import DuplicateSearch
from track_before_detect.solvers.convex.subspace_pursuit import pursue, PursuitSettings
from track_before_detect.solvers.convex.warm_start import starting_paths
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refine.partial_refinement import PartialRefiner
from track_before_detect.solvers.refine.refinement import Refiner
from track_before_detect.solvers.search.path_search import PathSearch

# Motions of which every batch begins afresh.
WITHOUT_START = ('range_doppler', 'range_bearing')

# Distance of paths that one search adds, in widths of the PSF.
SEPARATION = 3.0
# Share by which targets are wider or narrower than the PSF that is worth a word.
WRONG_WIDTH = 0.1

_LOG = logging.getLogger(__name__)


class ConvexDetector(PathDetector):
    """Finds all trajectories of a batch jointly, by the schedule ``continuation``."""

    # With more the threshold at a rate of 5 % stays the same within 0.1 % (on 400 batches).
    refined_in_noise = 3

    def __init__(self, options: DetectorOptions, measurement: MeasurementModel | None = None):
        super().__init__(options, measurement)
        self._width_warned = False

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        paths = task.paths
        refiner = self._refiner(task.graph, task.measurement, task.times, task.weights)
        result = pursue(task.search, refiner, paths, self._separation,
                        PursuitSettings(self.options.continuation), self._start(task))
        self._merge_duplicates(task)
        threshold = self.scale.statistic(self.model.value(paths.threshold), len(task.times))
        return BatchResult(self._collect(paths), threshold, result.status, result.history,
                           result.gap)

    def _merge_duplicates(self, task):
        """Leave one path for each target, though it may look unlike the PSF.

        Convex solutions stay as they are: their neighbouring paths and the certificate belong
        together. So do targets that enter and leave, streaks, several sensors and ambiguous
        Doppler, whose stamps are not made for it.
        """
        options, psf = self.options, task.measurement
        if (self.presence is not None or options.doppler_ambiguities
                or options.continuation[-1] > 0 or isinstance(psf, (MultiSensor, StreakPsf))):
            return
        search = DuplicateSearch(task.graph, task.times, task.weights, task.paths, psf.width_px)
        widths = search.merge()
        if not len(widths) or options.psf is not None or self._width_warned:
            return
        ratio = float(np.median(widths)) / psf.width_px
        if abs(ratio - 1) > WRONG_WIDTH:
            self._width_warned = True
            _LOG.warning('the targets look %.2g px wide, psf_sigma_px is %g',
                         ratio * options.psf_sigma_px, options.psf_sigma_px)

    def _start(self, task):
        """Return the paths to begin with."""
        # Positions on a strip or on the sheared plane are not those of the frames.
        if task.earlier is None or self.options.motion_model in WITHOUT_START:
            return []
        return starting_paths(task.graph, task.times, task.search.grid_shape, task.earlier,
                              self.presence)

    def largest_value(self, search: PathSearch, measurement: MeasurementModel, times: NDArray,
                      ) -> Callable[[NDArray], float]:
        """Return a function that returns the largest value of any refined path in noise.

        A target is decided on by its refined path. Only the best few of the grid are refined:
        the best after them is among these.
        """
        refiner = self._refiner(search.graph, measurement, times, np.zeros((0, 0, 0), np.float32))

        def largest(frames):
            search.forget()
            _, found = search.best_paths(frames, -np.inf, self._separation, lambda _: True,
                                         self.refined_in_noise)
            best = found[0].value
            for path in found:
                if path.value + self.model.refinement_gain < best:
                    break
                moved, cost = refiner.refine(frames, path.positions, path.cost,
                                             self.model.from_value(best), 0.0)
                best = max(best, refiner.value(frames, moved, cost))
            return best

        return largest

    @property
    def _separation(self):
        return SEPARATION * self.measurement.width_px

    def _refiner(self, graph, psf, times, weights):
        shared = (graph, psf, times, weights, self.model)
        return PartialRefiner(*shared, self.presence) if self.presence else Refiner(*shared)

    def _collect(self, paths):
        found = []
        for path in range(len(paths)):
            seen = paths.seen(path)
            model = paths.model
            present = self.scale.present(paths.positions[path], seen)
            visible = present & paths.visible(path)
            found.append(FoundTrajectory(
                np.where(present[:, None], paths.positions[path], np.nan),
                np.where(present, paths.target_amplitudes(path), np.nan),
                # Less its cost, so that every statistic meets the same threshold.
                self.scale.statistic(paths.value(path), len(seen)), model.snr(seen[visible])))
        return sorted(found, key=lambda trajectory: -trajectory.statistic)
