"""The convex detector on one batch of prepared frames."""

from collections.abc import Callable
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchResult
from track_before_detect.solvers.calibration.false_paths import modelled_false_paths
from track_before_detect.solvers.calibration.noise_study import FalsePaths
from track_before_detect.solvers.convex.ghosts import GhostSearch
from track_before_detect.solvers.convex.pursuit import pursue, PursuitSettings, state_of
from track_before_detect.solvers.convex.warm_start import starting_paths
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refine.refinement import refiner_for
from track_before_detect.solvers.refine.target_model import TargetModel
from track_before_detect.solvers.search.path_search import FoundPath, PathSearch
from track_before_detect.solvers.search.periodic_columns import PeriodicColumns
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
        refiner = refiner_for(task.targets)
        result = pursue(task.search, refiner, paths, self._separation,
                        PursuitSettings(self.options.continuation), self._start(task), task.watch)
        self._merge_duplicates(task, result.history)
        # Less their costs, so that every statistic meets the same threshold.
        found = [self.trajectory(paths, path, paths.value(path), refiner)
                 for path in range(len(paths))]
        return self.result(task, found, result.status, result.history, result.best, result.gap)

    def _merge_duplicates(self, task: Task, history: list[Step]) -> None:
        """Leave one path for each target, though it may look unlike the PSF.

        Convex solutions stay as they are: their neighbouring paths and the certificate belong
        together.
        """
        if self.options.continuation[-1] > 0:
            return
        paths, psf = task.paths, task.targets.measurement
        widths = GhostSearch(task.targets, paths, task.watch).merge()
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
        targets = task.targets
        limits = targets.measurement.limits(task.paths.frames.shape[1:])
        return starting_paths(targets.graph, targets.times, limits, task.earlier, self.presence)

    def largest_value(self, targets: TargetModel,
                      search: PathSearch) -> Callable[[NDArray], float]:
        """Return a function that returns the largest value of any refined path in noise.

        A target is decided on by its refined path. Only the best few of the grid are refined:
        the best after them is among these.
        """
        refiner = refiner_for(targets)

        def largest(frames: NDArray) -> float:
            search.forget()
            _, found = search.best_paths(frames, -np.inf, self._separation,
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

    def false_paths(self, graph: StateGraph, measurement: MeasurementModel,
                    columns: PeriodicColumns, shape: tuple[int, int]) -> FalsePaths | None:
        """Return how many paths of noise pass a level, None where only a search can tell."""
        if (graph.coupling is not None or columns.margin > 0
                or not measurement.is_one_gaussian):
            return None
        return modelled_false_paths(graph, measurement, self.model, self.presence, shape)

    @property
    def _separation(self) -> float:
        return SEPARATION * self.measurement.width_px
