"""The convex detector on one batch of prepared frames."""

from __future__ import annotations

from collections.abc import Callable
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.convex.duplicates import DuplicateSearch
from track_before_detect.solvers.convex.subspace_pursuit import pursue, PursuitSettings, state_of
from track_before_detect.solvers.convex.warm_start import starting_paths
from track_before_detect.solvers.convex.working_set import WorkingSet
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refine.refinement import PathRefiner, refiner_for
from track_before_detect.solvers.search.path_search import FoundPath, PathSearch
from track_before_detect.types import Step

# Distance of paths that one search adds, in widths of the PSF.
SEPARATION = 3.0
# Share by which targets are wider or narrower than the PSF that is worth a word.
WRONG_WIDTH = 0.1

_LOG = logging.getLogger(__name__)


class ConvexDetector(PathDetector):
    """Finds all trajectories of a batch jointly, by the schedule ``continuation``."""

    # Best paths of noise that are refined; more change nothing (docs/constants/convex.md).
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
        self._merge_duplicates(task, result.history)
        threshold = self.scale.statistic(self.model.value(paths.threshold), len(task.times))
        return BatchResult(self._collect(paths), threshold, result.status, result.history,
                           result.gap)

    def _merge_duplicates(self, task: Task, history: list[Step]) -> None:
        """Leave one path for each target, though it may look unlike the PSF.

        Convex solutions stay as they are: their neighbouring paths and the certificate belong
        together.
        """
        if self.options.continuation[-1] > 0:
            return
        paths, psf = task.paths, task.measurement
        widths = DuplicateSearch(task.graph, psf, task.times, task.weights, paths,
                                 self.presence).merge()
        if not len(widths):
            return
        history.append(state_of(paths, 0.0))
        ratio, sigma = float(np.median(widths)) / psf.width_px, psf.gaussian_sigma_px
        if sigma is not None and abs(ratio - 1) > WRONG_WIDTH and not self._width_warned:
            self._width_warned = True
            _LOG.warning('the targets look %.2g px wide, psf_sigma_px is %g', ratio * sigma, sigma)

    def _start(self, task: Task) -> list[FoundPath]:
        """Return the paths to begin with."""
        if task.earlier is None:
            return []
        limits = task.measurement.limits(task.paths.frames.shape[1:])
        return starting_paths(task.graph, task.times, limits, task.earlier, self.presence)

    def largest_value(self, search: PathSearch, measurement: MeasurementModel, times: NDArray,
                      ) -> Callable[[NDArray], float]:
        """Return a function that returns the largest value of any refined path in noise.

        A target is decided on by its refined path. Only the best few of the grid are refined:
        the best after them is among these.
        """
        refiner = self._refiner(search.graph, measurement, times, np.zeros((0, 0, 0), np.float32))

        def largest(frames: NDArray) -> float:
            search.forget()
            _, found = search.best_paths(frames, -np.inf, self._separation, lambda _: True,
                                         self.refined_in_noise)
            best = found[0].value
            for path in found:
                if path.value + self.model.refinement_gain < best:
                    break
                positions, cost = refiner.refine(
                    frames, path.positions, path.cost, self.model.from_value(best), 0.0,
                ) or (path.positions, path.cost)
                best = max(best, refiner.value(frames, positions, cost))
            return best

        return largest

    @property
    def _separation(self) -> float:
        return SEPARATION * self.measurement.width_px

    def _refiner(self, graph: StateGraph, psf: MeasurementModel, times: NDArray,
                 weights: NDArray) -> PathRefiner:
        return refiner_for(graph, psf, times, weights, self.model, self.presence)

    def _collect(self, paths: WorkingSet) -> list[FoundTrajectory]:
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
        return found
