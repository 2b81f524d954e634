"""Paths that stand out from the other paths of their batch: a false-alarm rate in clutter.

What is left of a real scene, edges, blocks of a codec, a fixed pattern, has heavier tails than
noise and stays where it is from frame to frame, so a threshold from noise says nothing. But it is
the same all over the frame, more or less: the strongest paths that are no target tell how strong
such a path gets, as the cells around one tell in an ordered-statistic CFAR (Rohling, Radar CFAR
thresholding in clutter and multiple target situations, 1983). The strongest path is set aside
together with its pixels, the tail of the others gives the threshold that it has to pass, and when
it does the next is tried.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.clutter.path_tail import path_tail, PathTail
from track_before_detect.solvers.clutter.reasons import reason_against
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refine.refinement import PathRefiner, refiner_for
from track_before_detect.solvers.search.path_search import FoundPath
from track_before_detect.types import Progress, Step

# Reason of candidates that may carry on a trajectory of a neighbouring batch.
BELOW = 'below the threshold'
# Reason of the strongest path where no other is a candidate.
FAR_BELOW = 'far below the threshold'
# Distance of paths that count as separate, and side of the square that is set aside with each at
# least, both in widths of the PSF.
SEPARATION = 5.0
# Paths looked at in each search.
N_PATHS = 60
# Paths whose positions are refined to find the strongest.
N_REFINED = 3
# Trajectories after which a batch is left.
MOST_TRAJECTORIES = 30
# Radius of the place where a trajectory of the batch before is expected, in widths of the PSF.
EXPECTED = 3.0
# Deviations beyond which pixels beside a target belong to it, however wide it is.
PART_OF_TARGET = 3.0


class ClutterDetector(PathDetector):
    """Finds the trajectories of a batch that stand out from all other paths in it.

    Statistics are in units of their threshold.
    """

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return 1: what statistics are compared with comes from each batch itself."""
        return 1.0

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        refiner = refiner_for(task.graph, task.measurement, task.times, task.weights, self.model,
                              None)
        frames, rate = task.paths.frames.copy(), self.options.false_alarm_rate
        found: list[FoundTrajectory] = []
        rejected: list[FoundTrajectory] = []
        status = 'iteration_limit'
        paths = self._strongest(task, frames)
        while paths and len(found) + len(rejected) < MOST_TRAJECTORIES:
            path = max((_refined(refiner, frames, path) for path in paths[:N_REFINED]),
                       key=lambda path: path.value)
            self._set_aside(frames, path.positions)
            others = self._strongest(task, frames)
            tail = self._tail(others, frames.shape[1:])
            level = tail.threshold(rate)
            trajectory = self._trajectory(task, path, level)
            if trajectory.statistic <= 1:
                paths.insert(0, path)
                status = 'converged'
                break
            reason = reason_against(trajectory, task.paths.frames,
                                    self.measurement.width_px, task.scene)
            (rejected if reason else found).append(replace(trajectory, reason=reason))
            paths = others
        if not paths:
            return BatchResult(found, 1.0, 'converged', [], float('nan'), rejected)
        share = math.pi * (EXPECTED * self.measurement.width_px) ** 2 / np.prod(frames.shape[1:])
        least = tail.threshold(rate, min(float(share), 1.0))
        rejected += [self._trajectory(task, path, level, BELOW) for path in paths
                     if self.scale.statistic(path.value, len(frames)) > least]
        if not found and not rejected:
            rejected = [self._trajectory(task, paths[0], level, FAR_BELOW)]
        strongest = max((path.value for path in paths), default=0.0)
        history = [Step(0.0, float('nan'), len(found),
                        self.scale.statistic(strongest, len(frames)) / level - 1)]
        return BatchResult(found, 1.0, status, history, float('nan'), rejected)

    def _threshold(self, *_: object) -> float:
        return 1.0

    def _strongest(self, task: Task, frames: NDArray) -> list[FoundPath]:
        """Return the strongest separate paths, the strongest first."""
        _, found = task.search.best_paths(
            frames, 0.0, SEPARATION * self.measurement.width_px, lambda _: True, N_PATHS)
        return found

    def _tail(self, paths: list[FoundPath], shape: tuple[int, ...]) -> PathTail:
        n_places = np.prod(shape) / (SEPARATION * self.measurement.width_px) ** 2
        statistics = [self.scale.statistic(path.value, len(path.positions)) for path in paths]
        return path_tail([*statistics, 0.0, 0.0, 0.0], float(n_places))

    def _set_aside(self, frames: NDArray, positions: NDArray) -> None:
        """Take the pixels of a path out of the frames, the whole of a wide target."""
        reach = SEPARATION * self.measurement.width_px
        for frame, (x, y) in zip(frames, positions, strict=True):
            wide = frame[_window(x, y, 3 * reach, frame.shape)]
            inner = np.zeros(frame.shape, bool)
            inner[_window(x, y, reach, frame.shape)] = True
            inner = inner[_window(x, y, 3 * reach, frame.shape)]
            parts, _ = ndimage.label((np.abs(wide) > PART_OF_TARGET) | inner, np.ones((3, 3)))
            own = np.unique(parts[inner])
            wide[np.isin(parts, own[own > 0])] = 0

    def _trajectory(self, task: Task, path: FoundPath, level: float,
                    reason: str = '') -> FoundTrajectory:
        paths = task.paths
        paths.add(path.positions, path.cost)
        added = len(paths) - 1
        seen = paths.seen(added)
        paths.assign(np.array([added]), paths.best(added)[None])
        visible = paths.visible(added)
        amplitudes = np.array(paths.target_amplitudes(added))
        statistic = self.scale.statistic(path.value, len(seen)) / level
        paths.remove(np.array([added]))
        return FoundTrajectory(path.positions, amplitudes, statistic,
                               self.model.snr(seen[visible]), reason)


def _window(x: float, y: float, reach: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the square around a position, as far as it lies in a frame."""
    rows, columns = ((max(math.ceil(at - reach), 0), max(math.floor(at + reach) + 1, 0))
                     for at in (y, x))
    return slice(*np.minimum(rows, shape[0])), slice(*np.minimum(columns, shape[1]))


def _refined(refiner: PathRefiner, frames: NDArray, path: FoundPath) -> FoundPath:
    """Return a path moved to where it explains most."""
    # Every threshold below a path refines it; it is not known yet.
    positions, cost = refiner.refine(frames, path.positions, path.cost, 1.0, 0.0) or (
        path.positions, path.cost)
    value = refiner.value(frames, positions, cost)
    return FoundPath(positions, value, cost) if value > path.value else path
