"""Targets whose amplitude is constant or fluctuates, untold which: two searches, one result.

A detector of either model searches the frames, each at its share of the false alarm rate, so that
a batch of noise yields a trajectory in one of them no more often than was asked. A target that
both find is reported once, with a constant amplitude.

The squares of both statistics are compared with the squares of their thresholds. Beyond these the
false alarms of both fall off alike, as exp(-x^2 / 2), and half the difference is what a target
lowers F_0 by. So a constant amplitude's statistic s is reported as sqrt(s^2 - c^2 + f^2), with c
and f the thresholds of constant and fluctuating amplitudes: the threshold is f, and what is above
it by as much is as unlikely in noise.

Beside a bright target whose amplitude fluctuates there is much that no constant amplitude
explains, and paths that follow it are no targets. So fluctuating amplitudes are searched first,
and those targets of which a constant amplitude would leave enough for a path are taken off the
frames. What only the second search finds has to pass on the frames less what only the first found.
"""

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
)
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.fit.working_set import WorkingSet
from track_before_detect.solvers.path_detector import PathDetector, Task
from track_before_detect.types import FrameBatch, Progress, worst_status

# Of the false alarm rate: fluctuating amplitudes need little of it (docs/constants/either.md).
SHARES = {'fluctuating': 0.15, 'constant': 0.85}
# Distance in widths of the PSF within which two paths may be one target, and the share of the
# frames of both in which they have to be.
NEAR = 3.0
SHARE = 0.25
# What a target adds to a pixel in units of the noise from which on it shows there: its halo is
# about as bright where it is a tenth wider than the PSF and three widths from the middle.
SHOWN = 0.3


class EitherDetector(BatchDetector):
    """Finds trajectories with the amplitude models fluctuating and constant.

    Parameters
    ----------
    options : DetectorOptions
        What to look for. A threshold is that of fluctuating amplitudes; that of constant ones is
        then less by as much, of the squares, as it is at the false alarm rate, or by the same
        share where the threshold is below that of the rate.
    kind : type of PathDetector
        The detector that searches.
    """

    def __init__(self, options: DetectorOptions, kind: type[PathDetector]):
        super().__init__(options)
        self._detectors = [
            kind(options.replace(amplitude_model=model, threshold=None,
                                 false_alarm_rate=share * options.false_alarm_rate))
            for model, share in SHARES.items()]

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return the threshold on the statistics of results, calibrating both models."""
        return self._thresholds_of_both(stamps, shape, progress)[0]

    def parts(self) -> Sequence[BatchDetector]:
        """Return the detectors of both models."""
        return self._detectors

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return that of fluctuating amplitudes, on whose scale statistics are."""
        return self._detectors[0].noise_study(stamps, shape)

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories."""
        self.check_kind(batch.frames)
        thresholds = self._thresholds_of_both(
            batch.stamps, batch.part_of or batch.frames.shape[1:], progress)
        searched_first, searched_then = self._detectors
        first = searched_first.task(batch, thresholds[0], weights, earlier, progress)
        if searched_first.passes_everywhere(first):
            return searched_first.result(first, [], 'not_noise', [])
        free = searched_first.solve(first)
        then = searched_then.task(batch, thresholds[1], weights, earlier, progress)
        changing = _changing(first, then)
        if len(changing):
            then = then._replace(paths=_holding(then, _without(first, changing)))
        constant = searched_then.solve(then)
        shift = free.threshold**2 - constant.threshold**2
        found = _joined(first, then, changing, free.found, [
            replace(one, statistic=math.sqrt(max(one.statistic**2 + shift, 0.0)))
            for one in constant.found])
        status = worst_status([free.status, constant.status])
        return first.in_frame(BatchResult(
            found, free.threshold, status, free.history + constant.history,
            max(free.gap, constant.gap), free.best_statistic))

    def _thresholds_of_both(self, stamps: NDArray, shape: tuple[int, int],
                            progress: Progress | None) -> tuple[float, float]:
        free, constant = (one.threshold(stamps, shape, progress) for one in self._detectors)
        given = self.options.threshold
        self.threshold_source = 'given' if given is not None else ', '.join(
            dict.fromkeys(one.threshold_source for one in self._detectors))
        if given is None:
            return free, constant
        return given, math.sqrt(max(given**2 - (free**2 - constant**2),
                                    (given * constant / free)**2))


def _joined(free: Task, constant: Task, changing: NDArray[np.int64],
            fluctuating: list[FoundTrajectory],
            steady: list[FoundTrajectory]) -> list[FoundTrajectory]:
    """Return each target once, for what both searches found on one scale of statistics.

    Parameters
    ----------
    free, constant : Task
        With the working sets of both, after the search.
    changing : array of int
        Paths of the first that were taken off the frames of the second.
    fluctuating, steady : list of FoundTrajectory
        What is in them, in the same order.
    """
    joined = list(fluctuating)
    alone = list(range(len(fluctuating)))
    unmatched = []
    for path in sorted(range(len(steady)), key=lambda path: -steady[path].statistic):
        one = steady[path]
        shares = [_share_near(free, one, fluctuating[other]) for other in alone]
        if max(shares, default=0.0) > SHARE:
            # A constant amplitude explains it, and follows less of the noise.
            joined[alone.pop(int(np.argmax(shares)))] = one
        else:
            unmatched.append(path)
    # All others are explained by both, or were taken off before.
    others = np.setdiff1d(np.arange(len(fluctuating)), np.setdiff1d(alone, changing))
    with free.paths.without(*others) as frames:
        left = _holding(constant, constant.paths.frames - (free.paths.frames - frames))
    for path in unmatched:
        again = left.add(constant.paths.positions[path], constant.paths.costs[path])
        seen = (constant.paths.seen(path) - constant.paths.matched[path] + left.matched[again])
        if left.statistic(again, seen) > left.penalties[again]:
            joined.append(steady[path])
    return joined


def _share_near(task: Task, one: FoundTrajectory, other: FoundTrajectory) -> float:
    """Return the share of the frames with both targets in which they are near each other."""
    offsets = one.positions - other.positions
    offsets = offsets[np.isfinite(offsets[:, 0])]
    if not len(offsets):
        return 0.0
    if task.columns.period is not None:
        offsets[:, 0] -= task.columns.period * np.rint(offsets[:, 0] / task.columns.period)
    return float(np.mean(np.hypot(*offsets.T) < NEAR * task.targets.measurement.width_px))


def _changing(free: Task, constant: Task) -> NDArray[np.int64]:
    """Return the paths of which a constant amplitude would leave enough for one more path."""
    paths, model = free.paths, constant.paths.model
    return np.array([
        path for path in range(len(paths))
        if paths.statistic(path)**2 - paths.statistic(path, model=model)**2
        > paths.n_present(path) - 1 + constant.paths.least_penalty**2], np.int64)


def _without(task: Task, paths: NDArray[np.int64]) -> NDArray:
    """Return the frames of a task less some of its paths, with nothing where they show.

    What a target of another shape than the PSF leaves there would look like more targets.
    """
    others = np.setdiff1d(np.arange(len(task.paths)), paths)
    with task.paths.without(*others) as left:
        return np.where(np.abs(task.paths.frames - left) > SHOWN, left.dtype.type(0), left)


def _holding(task: Task, frames: NDArray) -> WorkingSet:
    """Return an empty working set of a task for other frames."""
    targets = task.targets
    return WorkingSet(frames, targets.pixel_weights, targets.measurement, task.paths.least_penalty,
                      task.paths.model, task.columns.period)
