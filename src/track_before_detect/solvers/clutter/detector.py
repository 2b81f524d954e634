"""Paths that stand out from the other paths of their batch: a false-alarm rate in clutter.

What is left of a real scene, edges, blocks of a codec, a fixed pattern, has heavier tails than
noise and stays where it is from frame to frame, so a threshold from noise says nothing. But it is
the same all over the frame, more or less: the strongest paths that are no target tell how strong
such a path gets, as the cells around one tell in an ordered-statistic CFAR (Rohling, Radar CFAR
thresholding in clutter and multiple target situations, 1983). The strongest path is set aside
together with its pixels, the tail of the others gives the threshold that it has to pass, and when
it does the next is tried.
"""

from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchResult, FoundTrajectory
from track_before_detect.solvers.clutter.path_tail import path_tail, PathTail
from track_before_detect.solvers.clutter.reasons import (
    IN_ONE_FRAME,
    ON_BORDER,
    reason_against,
)
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refine.refinement import PathRefiner, refiner_for
from track_before_detect.solvers.search.path_search import FoundPath
from track_before_detect.types import Progress, Step

BELOW = 'below the threshold'
# Reasons that say nothing against a candidate that carries on a trajectory of the batch beside.
MAY_CARRY_ON = (BELOW, ON_BORDER, IN_ONE_FRAME)
# Reason of the strongest path where no other is a candidate.
FAR_BELOW = 'far below the threshold'
# Distance of paths that count as separate, and side of the square that is set aside with each at
# least, both in widths of the PSF.
SEPARATION = 5.0
# Paths looked at in each search.
N_PATHS = 80
# Share of the frames in which two paths are near each other and count as one in the tail.
TOUCHING = 0.2
# Paths whose positions are refined to find the strongest.
N_REFINED = 3
# Trajectories after which a batch is left.
MOST_TRAJECTORIES = 30
# Radius of the place where a trajectory of the batch before is expected, in widths of the PSF.
EXPECTED = 3.0
# Deviations beyond which pixels beside a target belong to it, however wide it is.
PART_OF_TARGET = 3.0
# Widths of the PSF by which what belongs to a target is grown: its slopes add up over the frames.
SLOPE = 2.0


class ClutterDetector(PathDetector):
    """Finds the trajectories of a batch that stand out from all other paths in it.

    Statistics are in units of their threshold. Paths are searched on whole pixels and refined.
    """

    def __init__(self, options: DetectorOptions, measurement: MeasurementModel | None = None):
        super().__init__(options, measurement or psf_of(options).on_whole_pixels())

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return 1: what statistics are compared with comes from each batch itself."""
        return 1.0

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        refiner = refiner_for(task.targets)
        frames, rate = task.paths.frames.copy(), self.options.false_alarm_rate
        found: list[FoundTrajectory] = []
        rejected: list[FoundTrajectory] = []
        status = 'iteration_limit'
        others, level, least = self._strongest(task, frames), math.inf, math.inf
        share = math.pi * (EXPECTED * self.measurement.width_px) ** 2 / np.prod(frames.shape[1:])
        while len(found) + len(rejected) < MOST_TRAJECTORIES and not task.watch.time_is_up():
            if not others:
                status = 'converged'
                break
            path = max((_refined(refiner, frames, path) for path in others[:N_REFINED]),
                       key=lambda path: path.value)
            self._set_aside(frames, path.positions)
            others = self._strongest(task, frames)
            if not others:
                # Nothing is left of the frames that it could be compared with.
                status = 'converged'
                break
            tail = self._tail(others, frames.shape[1:])
            level, least = tail.threshold(rate), tail.threshold(rate, min(float(share), 1.0))
            trajectory = self._trajectory(task, path, level, refiner=refiner)
            if trajectory.statistic <= 1:
                others.insert(0, path)
                status = 'converged'
                break
            reason = reason_against(trajectory, task.paths.frames,
                                    self.measurement.width_px, task.scene)
            (rejected if reason else found).append(replace(trajectory, reason=reason))
        rejected += [self._trajectory(task, path, level, BELOW) for path in others
                     if self.scale.statistic(path.value, len(frames)) > least]
        if not found and not rejected and others:
            rejected = [self._trajectory(task, others[0], level, FAR_BELOW)]
        strongest = max((path.value for path in others), default=0.0)
        best = self.scale.statistic(strongest, len(frames)) / level
        history = [Step(0.0, float('nan'), len(found), best - 1)]
        return BatchResult(found, 1.0, task.watch.status(status), history,
                           best_statistic=best, rejected=rejected)

    def passes_everywhere(self, task: Task) -> bool:
        """Return False: whatever the frames hold, few paths stand out from the others."""
        return False

    def _threshold(self, *_: object) -> float:
        return 1.0

    def _strongest(self, task: Task, frames: NDArray) -> list[FoundPath]:
        """Return the strongest separate paths, the strongest first."""
        _, found = task.search.best_paths(
            frames, 0.0, SEPARATION * self.measurement.width_px, lambda _: True, N_PATHS)
        return found

    def _tail(self, paths: list[FoundPath], shape: tuple[int, ...]) -> PathTail:
        reach = SEPARATION * self.measurement.width_px
        apart: list[FoundPath] = []
        for path in paths:
            # Paths that touch a stronger one on their way owe it what they have.
            if not any(np.mean(np.hypot(*(path.positions - other.positions).T) < reach) > TOUCHING
                       for other in apart):
                apart.append(path)
        statistics = [self.scale.statistic(path.value, len(path.positions)) for path in apart]
        return path_tail([*statistics, *[0.0] * max(3 - len(statistics), 0)],
                         float(np.prod(shape) / reach**2))

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
            slope = 2 * round(SLOPE * self.measurement.width_px) + 1
            wide[ndimage.maximum_filter(np.isin(parts, own[own > 0]), slope)] = 0

    def _trajectory(self, task: Task, path: FoundPath, level: float,
                    reason: str = '', refiner: PathRefiner | None = None) -> FoundTrajectory:
        paths = task.paths
        added = paths.add(path.positions, path.cost)
        paths.assign(np.array([added]), paths.best(added)[None])
        found = self.trajectory(paths, added, path.value, refiner)
        paths.remove(np.array([added]))
        return replace(found, statistic=found.statistic / level, reason=reason)


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
