"""The convex detector on one batch of prepared frames."""

from __future__ import annotations

import numpy as np

from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refinement import Refiner
from track_before_detect.solvers.subspace_pursuit import pursue, PursuitSettings


class ConvexDetector(PathDetector):
    """Finds all trajectories of a batch jointly, by the schedule ``continuation``."""

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        paths = task.paths
        refiner = Refiner(task.graph, self.psf, task.times, task.weights, self.model)
        result = pursue(task.search, refiner, paths, 3 * self.psf.width_px,
                        PursuitSettings(self.options.continuation))
        return BatchResult(self._collect(paths), paths.threshold, result.status, result.history,
                           result.gap)

    def _collect(self, paths):
        found = []
        for path in range(len(paths)):
            seen = paths.seen(path)
            model = paths.model
            # Less the cost of its turns, so that every statistic meets the same threshold.
            value = model.value(model.statistic(seen)) - paths.costs[path]
            found.append(FoundTrajectory(
                paths.positions[path], paths.amplitudes[path].copy(), model.from_value(value),
                float(np.mean(seen))))
        return sorted(found, key=lambda trajectory: -trajectory.statistic)
