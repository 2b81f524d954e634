"""The plain greedy method, to compare with: one target after another (Patent, paragraph 75).

The best path is taken while it passes the threshold, its amplitudes are fitted alone, and what
they explain is subtracted for good. No path is fitted again beside those that follow, none is
moved off the grid: what an early path took from its neighbour stays taken.
"""

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
        bound = model.value(paths.least_penalty)
        history: list[Step] = []
        found: list[FoundTrajectory] = []
        status, left = 'iteration_limit', float('nan')
        for _ in range(MOST_PATHS):
            if task.watch.time_is_up():
                break
            largest, best = task.search.best_paths(paths.residual, bound, 1.0, 1)
            left = float('nan') if largest == bound else largest
            violation = model.from_value(largest) / paths.least_penalty - 1
            history.append(Step(0.0, paths.objective(0.0), len(paths), violation))
            if not best:
                status = 'converged'
                break
            [path] = best
            paths.add(path.positions, path.cost)
            added = len(paths) - 1
            paths.assign(np.array([added]), paths.best(added)[None])
            found.append(self.trajectory(paths, added, path.value))
        return self.result(task, found, status, history, left)
