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
from track_before_detect.solvers.clutter.path_tail import MOST_PATHS, PathTail, tail_behind
from track_before_detect.solvers.clutter.reasons import (
    IN_ONE_FRAME,
    is_shadow,
    ON_BORDER,
    reason_against,
    SHADOW,
)
from track_before_detect.solvers.clutter.strongest_paths import (
    N_PATHS,
    SignedPath,
    strength,
    StrongestPaths,
)
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.solvers.refine.refinement import PathRefiner, refiner_for
from track_before_detect.types import Progress, Step

BELOW = 'below the threshold'
# Reasons that say nothing against a candidate that carries on a trajectory of the batch beside.
MAY_CARRY_ON = (BELOW, ON_BORDER, IN_ONE_FRAME)
# Reason of the strongest path where no other is a candidate.
FAR_BELOW = 'far below the threshold'
# Distance of paths that count as separate, and side of the square that is set aside with each at
# least, both in widths of the PSF.
SEPARATION = 5.0
# Half side of the window in which a wide target is set aside, by that square.
AROUND = 3
# Share of the frames in which two paths are near each other and count as one in the tail.
TOUCHING = 0.2
# Paths whose positions are refined to find the strongest.
N_REFINED = 3
# Trajectories after which a batch is left.
MOST_TRAJECTORIES = 30
# What no amplitude that fluctuates asks for.
NO_ENVELOPE = np.empty(0)
# Radius of the place where a trajectory of the batch before is expected, in widths of the PSF.
EXPECTED = 3.0
# Deviations beyond which pixels beside a target belong to it, however wide it is.
PART_OF_TARGET = 3.0
# Widths of the PSF by which what belongs to a target is grown: its slopes add up over the frames.
SLOPE = 2.0


class ClutterDetector(PathDetector):
    """Finds the trajectories of a batch that stand out from all other paths in it.

    Statistics are in units of their threshold. Paths are searched on whole pixels and refined.
    Targets of ``amplitudes=signed`` are bright throughout a batch, or dark.
    """

    # The strongest of the noise are sought as well.
    few_pass = False

    def __init__(self, options: DetectorOptions, measurement: MeasurementModel | None = None):
        self._signs: tuple[int, ...] = (1,)
        if options.amplitudes == 'signed':
            self._signs, options = (1, -1), options.replace(amplitudes='non-negative')
        super().__init__(options, measurement or psf_of(options).on_whole_pixels())

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return 1: what statistics are compared with comes from each batch itself."""
        self.threshold_source = 'batch'
        return 1.0

    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""
        refiner = refiner_for(task.targets)
        strongest = StrongestPaths(
            task, refiner, self._signs, SEPARATION * self.measurement.width_px)
        frames, rate = strongest.frames, self.options.false_alarm_rate
        found: list[FoundTrajectory] = []
        rejected: list[FoundTrajectory] = []
        status = 'iteration_limit'
        others, level, least = strongest.by_strength(), math.inf, math.inf
        share = math.pi * (EXPECTED * self.measurement.width_px) ** 2 / np.prod(frames.shape[1:])
        while len(found) + len(rejected) < MOST_TRAJECTORIES and not task.watch.time_is_up():
            if not others:
                status = 'converged'
                break
            path = max((strongest.refined(path) for path in others[:N_REFINED]), key=strength)
            strongest.without_touched(path.positions, self._set_aside(frames, path.positions))
            others = strongest.by_strength()
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
            width_px = self.measurement.width_px
            reason = (SHADOW if any(is_shadow(trajectory, one, width_px) for one in found) else
                      reason_against(trajectory, task.paths.frames, width_px, task.scene))
            (rejected if reason else found).append(replace(trajectory, reason=reason))
            strongest.renew(path.sign)
            others = strongest.by_strength()
        rejected += [self._trajectory(task, path, level, BELOW) for path in others[:N_PATHS]
                     if self.scale.statistic(path.value, len(frames)) > least]
        if not found and not rejected and others:
            rejected = [self._trajectory(task, others[0], level, FAR_BELOW)]
        best = self.scale.statistic(max(map(strength, others), default=0.0), len(frames)) / level
        history = [Step(0.0, float('nan'), len(found), best - 1)]
        return BatchResult(found, 1.0, task.watch.status(status), history,
                           best_statistic=best, rejected=rejected)

    def passes_everywhere(self, task: Task) -> bool:
        """Return False: whatever the frames hold, few paths stand out from the others."""
        return False

    def _tail(self, paths: list[SignedPath], shape: tuple[int, ...]) -> PathTail:
        reach = SEPARATION * self.measurement.width_px
        apart: list[SignedPath] = []
        taken = np.empty((0, len(paths[0].positions), 2))
        for path in paths:
            # Paths that touch a stronger one on their way owe it what they have.
            near = np.hypot(*(path.positions - taken).transpose(2, 0, 1)) < reach
            if not np.any(near.mean(axis=1) > TOUCHING):
                apart.append(path)
                taken = np.concatenate([taken, path.positions[None]])
            if len(apart) > MOST_PATHS:
                break
        statistics = [self.scale.statistic(path.value, len(path.positions)) for path in apart]
        return tail_behind([*statistics, *[0.0] * max(3 - len(statistics), 0)],
                           float(np.prod(shape) / reach**2), self.options.false_alarm_rate)

    def _set_aside(self, frames: NDArray, positions: NDArray) -> float:
        """Take the pixels of a path out of the frames, the whole of a wide target.

        Return how far from the path they are at most, along either axis.
        """
        reach = SEPARATION * self.measurement.width_px
        for frame, (x, y) in zip(frames, positions, strict=True):
            around = _window(x, y, AROUND * reach, frame.shape)
            wide = frame[around]
            inner = np.zeros(wide.shape, bool)
            inner[tuple(slice(part.start - whole.start, part.stop - whole.start) for part, whole
                        in zip(_window(x, y, reach, frame.shape), around, strict=True))] = True
            parts, _ = ndimage.label((np.abs(wide) > PART_OF_TARGET) | inner, np.ones((3, 3)))
            own = np.unique(parts[inner])
            slope = 2 * round(SLOPE * self.measurement.width_px) + 1
            wide[ndimage.maximum_filter(np.isin(parts, own[own > 0]), slope)] = 0
        return AROUND * reach

    def _trajectory(self, task: Task, path: SignedPath, level: float,
                    reason: str = '', refiner: PathRefiner | None = None) -> FoundTrajectory:
        paths = task.paths
        covariance = None if refiner is None else refiner.covariance(
            path.sign * paths.frames, path.positions)
        seen, amplitudes = paths.fit_alone(path.positions, lambda seen: path.sign * (
            self.model.best(path.sign * seen, NO_ENVELOPE)))
        found = self.target(path.positions, seen, amplitudes, path.value, covariance)
        return replace(found, statistic=found.statistic / level, reason=reason)


def _window(x: float, y: float, reach: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the square around a position, as far as it lies in a frame."""
    rows, columns = ((max(math.ceil(at - reach), 0), max(math.floor(at + reach) + 1, 0))
                     for at in (y, x))
    return slice(*np.minimum(rows, shape[0])), slice(*np.minimum(columns, shape[1]))
