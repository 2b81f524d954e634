"""The convex detector on one batch of prepared frames."""

from __future__ import annotations

import numpy as np

from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.partial_refinement import PartialRefiner
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refinement import Refiner
from track_before_detect.solvers.subspace_pursuit import pursue, PursuitSettings
from track_before_detect.solvers.warm_start import starting_paths

# Motions of which every batch begins afresh.
WITHOUT_START = ('range_doppler', 'range_bearing')


class ConvexDetector(PathDetector):
    """Finds all trajectories of a batch jointly, by the schedule ``continuation``."""

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        paths = task.paths
        shared = (task.graph, task.psf, task.times, task.weights, self.model)
        refiner = PartialRefiner(*shared, self.presence) if self.presence else Refiner(*shared)
        result = pursue(task.search, refiner, paths, 3 * self.psf.width_px,
                        PursuitSettings(self.options.continuation), self._start(task))
        threshold = self.statistic(self.model.value(paths.threshold), len(task.times))
        return BatchResult(self._collect(paths), threshold, result.status, result.history,
                           result.gap)

    def _start(self, task):
        """Return the paths to begin with."""
        # Positions on a strip or on the sheared plane are not those of the frames.
        if self.earlier is None or self.options.motion_model in WITHOUT_START:
            return []
        return starting_paths(task.graph, task.times, task.search.grid_shape, self.earlier,
                              self.presence)

    def _collect(self, paths):
        found = []
        for path in range(len(paths)):
            seen = paths.seen(path)
            model = paths.model
            present = self.present(paths.positions[path], seen)
            found.append(FoundTrajectory(
                np.where(present[:, None], paths.positions[path], np.nan),
                np.where(present, paths.target_amplitudes(path), np.nan),
                # Less its cost, so that every statistic meets the same threshold.
                self.statistic(paths.value(path), len(seen)), model.snr(seen[present])))
        return sorted(found, key=lambda trajectory: -trajectory.statistic)
