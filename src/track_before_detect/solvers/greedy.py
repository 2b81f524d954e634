"""The plain greedy method, to compare with: one target after another (Patent, paragraph 75).

The best path is taken while it passes the threshold, its amplitudes are fitted alone, and what
they explain is subtracted for good. No path is fitted again beside those that follow, none is
moved off the grid: what an early path took from its neighbour stays taken.
"""

from __future__ import annotations

import numpy as np

from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.types import Step

# Every path lowers the energy of the residual, so the search ends, but what rounding leaves of an
# extremely bright target could be followed for long.
MOST_PATHS = 1000


class GreedyDetector(PathDetector):
    """Finds the trajectories of a batch one by one."""

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        paths, model = task.paths, self.model
        bound = model.value(paths.threshold)
        history: list[Step] = []
        found: list[FoundTrajectory] = []
        status = 'iteration_limit'
        for _ in range(MOST_PATHS):
            largest, best = task.search.best_paths(
                paths.residual, bound, 1.0, lambda positions: True, 1)
            violation = model.from_value(largest) / paths.threshold - 1
            history.append(Step(0.0, paths.objective(0.0), len(paths), violation))
            if not best:
                status = 'converged'
                break
            [path] = best
            paths.add(path.positions, path.cost)
            added = len(paths) - 1
            seen = paths.seen(added)
            paths.assign(np.array([added]), paths.best(added)[None])
            present = self.scale.present(path.positions, seen)
            visible = present & paths.visible(added)
            found.append(FoundTrajectory(
                np.where(present[:, None], path.positions, np.nan),
                np.where(present, paths.target_amplitudes(added), np.nan),
                self.scale.statistic(path.value, len(seen)), model.snr(seen[visible])))
        threshold = self.scale.statistic(model.value(paths.threshold), len(task.times))
        return BatchResult(found, threshold, status, history, float('nan'))
