"""What the detectors that search a state graph share: from a batch to paths and back."""

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
import logging
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.models.amplitudes import amplitude_model
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.measurement.streak import StreakPsf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import presence_for
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import usable_cores
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
    max_speed,
    SAME_INTERVAL,
)
from track_before_detect.solvers.calibration.noise_study import FalsePaths, NoiseStudy
from track_before_detect.solvers.calibration.path_noise import path_noise_study
from track_before_detect.solvers.fit.working_set import WorkingSet
from track_before_detect.solvers.graph_builder import GraphBuilder
from track_before_detect.solvers.noise_check import passes_everywhere, threshold_bound
from track_before_detect.solvers.path_statistic import PathStatistic
from track_before_detect.solvers.refine.refinement import PathRefiner, refiner_for
from track_before_detect.solvers.refine.target_model import NO_WEIGHTS, TargetModel
from track_before_detect.solvers.search.affordable import search_bytes
from track_before_detect.solvers.search.memory import BYTES_PER_GB, memory_for_search
from track_before_detect.solvers.search.path_search import path_search, PathSearch
from track_before_detect.solvers.search.periodic_columns import (
    columns_of,
    doppler_columns,
    PeriodicColumns,
)
from track_before_detect.solvers.tiles import tile_shape
from track_before_detect.solvers.watch import Watch
from track_before_detect.timestamps import median_interval
from track_before_detect.types import FrameBatch, Progress, Step

# Longest streak over that of a target at the largest speed: velocities between frames differ from
# those of the search.
LONGER_STREAK = 1.1
# Least share of the frames of a batch that come from the same sensors as in one whose calibration
# it shares (docs/constants/calibration.md).
SAME_FRAMES = 0.5
# Memory from which on it is told, and how much more than was told is told again: batches of one
# stream differ a little.
WORTH_TELLING_GB, AGAIN = 0.1, 1.5

_LOG = logging.getLogger(__name__)


class Task(NamedTuple):
    """One batch, ready to be searched.

    Attributes
    ----------
    targets : TargetModel
        What is known of the targets.
    search : PathSearch
        Finds the best of their paths.
    paths : WorkingSet
        Holds the frames; starts empty.
    earlier : EarlierPaths or None
        Where targets of the batch before are, on the plane that is searched.
    watch : Watch
        Says when the time is up.
    columns : PeriodicColumns
        How that plane is made of the frames.
    scene : array, shape (T, 3, 3), or None
        How the scene moves in the frames; see :class:`FrameBatch`.
    """

    targets: TargetModel
    search: PathSearch
    paths: WorkingSet
    earlier: EarlierPaths | None
    watch: Watch
    columns: PeriodicColumns
    scene: NDArray[np.float64] | None

    def in_frame(self, result: BatchResult) -> BatchResult:
        """Return a result with its targets in the frames, the strongest first."""
        found = self.columns.in_frame(result.found)
        return replace(result, found=sorted(found, key=lambda one: -one.statistic))


class PathDetector(BatchDetector):
    """Finds trajectories among the paths of a state graph.

    Parameters
    ----------
    options : DetectorOptions
        Motion, PSF, amplitudes and threshold.
    measurement : MeasurementModel, optional
        How each of several sensors sees a common plane: batches say which of them took which
        frame. Without it every frame comes from one sensor, in its own pixels.
    """

    # Best paths of noise whose positions are refined.
    refined_in_noise = 0
    # Whether few paths pass the levels that are searched for.
    few_pass = True

    def __init__(self, options: DetectorOptions, measurement: MeasurementModel | None = None):
        super().__init__(options)
        self.measurement: MeasurementModel = measurement or psf_of(options)
        self.model = amplitude_model(options.amplitudes, options.amplitude_model)
        self.presence = presence_for(self.model) if options.presence == 'partial' else None
        self.scale = PathStatistic(self.model, self.presence)
        # What is free changes as soon as it is taken.
        self._most_bytes = memory_for_search(options.max_memory_gb)
        self._told_bytes = 0
        self._graphs = GraphBuilder(options, self.model, self.presence, self._most_bytes)
        self._search: tuple[tuple, PathSearch] | None = None
        # Duration, frames of each sensor, and threshold of what was calibrated.
        self._of_sensors: list[tuple[float, Counter[int], float]] = []
        self._has_searched = False

    def graph(self, stamps: NDArray, shape: tuple[int, int]) -> StateGraph:
        """Return the paths that are searched on a plane (H, W) in frames taken at ``stamps``."""
        return self._graph(stamps, self._measurement(stamps), shape)

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic of any path in noise."""
        return self._noise_study(stamps, self._measurement(stamps), shape)

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories."""
        self.check_kind(batch.frames)
        if self.options.threshold is None and not self._has_searched:
            # A calibration, which may take long, would be for nothing.
            task = self.task(batch, None, weights, earlier, progress)
            if self.passes_everywhere(task):
                return self.result(task, [], 'not_noise', [])
        measurement = self._measurement(batch.stamps, batch.taken)
        shape = batch.part_of or measurement.plane_shape(batch.frames.shape[1:])
        threshold = self._threshold(batch, measurement, shape, progress)
        self._has_searched = True
        task = self.task(batch, threshold, weights, earlier, progress)
        if self.passes_everywhere(task):
            return self.result(task, [], 'not_noise', [])
        return task.in_frame(self.solve(task))

    def task(self, batch: FrameBatch, threshold: float | None, weights: NDArray | None = None,
             earlier: EarlierPaths | None = None, progress: Progress | None = None) -> Task:
        """Return a batch ready to be searched with a threshold; see :meth:`detect`.

        Without a threshold, with one that no calibration exceeds.
        """
        stamps = batch.stamps
        measurement = self._measurement(stamps, batch.taken)
        shape = measurement.plane_shape(batch.frames.shape[1:])
        graph = self._graph(stamps, measurement, batch.part_of or shape)
        columns = columns_of(self.options, measurement, shape[1], graph)
        frames, weights = self._searched(columns.strip(batch.frames), weights if weights is None
                                         else columns.strip(np.asarray(weights)))
        search = self._path_search(graph, measurement, columns.plane(shape), weights)
        if threshold is None:
            threshold = threshold_bound(graph, search.grid_shape, self.options.false_alarm_rate)
        targets = TargetModel(graph, measurement, self._graphs.times(stamps, measurement),
                              NO_WEIGHTS if weights is None else weights, self.model,
                              self.presence)
        paths = WorkingSet(frames, targets.pixel_weights, measurement,
                           self.scale.penalty(threshold, len(frames)), self.model, columns.period)
        return Task(targets, search, paths, columns.on_strip(earlier),
                    Watch(self.options.max_time_s, progress), columns, batch.scene)

    def passes_everywhere(self, task: Task) -> bool:
        """Return whether most places pass the threshold, which no noise does."""
        cost = self.presence.whole_cost(len(task.paths.frames)) if self.presence else 0.0
        return passes_everywhere(task.search, refiner_for(task.targets), task.paths,
                                 task.targets.measurement, cost, task.watch)

    @abstractmethod
    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch, in the order in which its working set holds them."""

    def trajectory(self, paths: WorkingSet, path: int, value: float,
                   refiner: PathRefiner | None = None) -> FoundTrajectory:
        """Return the target of a path of this value that is held.

        With its covariance where there is a ``refiner``, that by which it was refined.
        """
        covariance = None
        if refiner is not None:
            with paths.without(path) as frames:
                covariance = refiner.covariance(frames, paths.positions[path])
        return self.target(paths.positions[path], paths.seen(path),
                           paths.target_amplitudes(path), value, covariance)

    def target(self, positions: NDArray, seen: NDArray, amplitudes: NDArray, value: float,
               covariance: NDArray | None = None) -> FoundTrajectory:
        """Return the target of a path of this value.

        With what is ``seen`` along it (T,) and the amplitudes of the target (T,), NaN in a frame
        that shows nothing of it.
        """
        present = self.scale.present(positions, seen)
        if covariance is not None:
            covariance[~present] = np.nan
        return FoundTrajectory(
            np.where(present[:, None], positions, np.nan), np.where(present, amplitudes, np.nan),
            self.scale.statistic(value, len(seen)),
            self.model.snr(seen[present & ~np.isnan(amplitudes)]), covariance=covariance)

    def result(self, task: Task, found: list[FoundTrajectory], status: str, history: list[Step],
               best: float = float('nan'), gap: float = float('nan')) -> BatchResult:
        """Return what was found, with the threshold of a statistic.

        ``best`` is the value of the best path that the last search left, NaN when not known.
        """
        n_frames = len(task.paths.frames)
        threshold = self.scale.statistic(
            self.model.value(task.paths.least_penalty), n_frames)
        best = self.scale.statistic(best, n_frames) if best > 0 else float('nan')
        return BatchResult(found, threshold, task.watch.status(status), history, gap, best)

    def largest_value(self, targets: TargetModel,
                      search: PathSearch) -> Callable[[NDArray], float]:
        """Return a function that returns the largest value of any path in frames of noise."""
        return search.best_value

    def false_paths(self, graph: StateGraph, measurement: MeasurementModel,
                    columns: PeriodicColumns, shape: tuple[int, int]) -> FalsePaths | None:
        """Return how many paths of noise pass a level, None where only a search can tell."""
        return None

    def _graph(self, stamps: NDArray, measurement: MeasurementModel,
               shape: tuple[int, int]) -> StateGraph:
        margin = doppler_columns(self.options, measurement, shape[1]).margin
        shape = tile_shape(self.options, stamps, shape, measurement)
        return self._graphs.graph(stamps, measurement, shape, margin)

    def _threshold(self, batch: FrameBatch, measurement: MeasurementModel,
                   shape: tuple[int, int], progress: Progress | None) -> float:
        stamps, taken = batch.stamps, batch.taken
        if self.options.threshold is not None or taken is None:
            return self.threshold(stamps, shape, progress)
        # Which of several sensors looked matters, and how fast, but no more than a little the
        # moments: as for one sensor, a calibration for each pattern would stop a stream.
        lasts, counts = float(np.ptp(stamps)), Counter(taken[:, 0].tolist())
        for known_lasts, known, threshold in self._of_sensors:
            if ((counts & known).total() >= SAME_FRAMES * max(counts.total(), known.total())
                    and abs(lasts - known_lasts) <= SAME_INTERVAL * known_lasts):
                return threshold
        study = self._noise_study(stamps, measurement, shape)
        threshold = self.calibrated(study, shape, progress).threshold
        self._of_sensors.append((lasts, counts, threshold))
        return threshold

    def _noise_study(self, stamps: NDArray, measurement: MeasurementModel,
                     shape: tuple[int, int]) -> NoiseStudy:
        graph = self._graph(stamps, measurement, shape)
        times = self._graphs.times(stamps, measurement)

        def searcher(crop: tuple[int, int]) -> Callable[[NDArray], float]:
            seen_as = measurement.window(crop)
            # One crop is searched on each core.
            search = path_search(graph, seen_as, columns.plane(crop), self.model, self.presence,
                                 most_bytes=self._most_bytes / usable_cores())
            return self.largest_value(
                TargetModel(graph, seen_as, times, NO_WEIGHTS, self.model, self.presence), search)

        columns = columns_of(self.options, measurement, shape[1], graph)
        return path_noise_study(type(self).__name__, graph, measurement, columns, self.scale,
                                searcher, self.refined_in_noise,
                                self.false_paths(graph, measurement, columns, shape))

    def _measurement(self, stamps: NDArray, taken: NDArray | None = None) -> MeasurementModel:
        """Return what a target looks like in frames taken at ``stamps``, by which sensor."""
        exposure = self.options.exposure_s
        if not exposure or len(stamps) == 1:
            return self.measurement if taken is None else self.measurement.slice(taken[:, 0])
        interval = median_interval(stamps)
        if exposure > interval:
            raise ParameterError(
                f'exposure_s must be at most the median interval of the frames, {interval:g} s, '
                f'got {exposure:g} s')
        share = float(f'{exposure / interval:.3g}')
        longest = LONGER_STREAK * share * max_speed(self.options, stamps) * interval
        times = self._graphs.times(stamps, self.measurement)
        return StreakPsf(psf_of(self.options), share, longest, tuple(times.tolist()))

    def _searched(self, frames: NDArray,
                  weights: NDArray | None) -> tuple[NDArray, NDArray | None]:
        """Return frames and weights as they are searched: masked pixels zero in both."""
        frames = np.ascontiguousarray(
            frames, np.complex64 if self.model.is_complex else np.float32)
        valid = np.isfinite(frames)
        if not valid.all():
            frames = np.where(valid, frames, frames.dtype.type(0))
            weights = valid.astype(np.float32) if weights is None else weights * valid
        if weights is not None:
            weights = np.ascontiguousarray(weights, np.float32)
        return frames, weights

    def _path_search(self, graph: StateGraph, measurement: MeasurementModel,
                     shape: tuple[int, int], weights: NDArray | None) -> PathSearch:
        """Return the search for these paths, with its tables where the last one had them."""
        key = (shape, graph.fingerprint(), measurement.key)
        if self._search is None or self._search[0] != key:
            self._search = None
            self._tell_memory(graph, measurement, shape)
            self._search = (key, path_search(graph, measurement, shape, self.model, self.presence,
                                             usable_cores(), self._most_bytes,
                                             self.few_pass))
        self._search[1].set_weights(weights)
        return self._search[1]

    def _tell_memory(self, graph: StateGraph, measurement: MeasurementModel,
                     shape: tuple[int, int]) -> None:
        """Say what a search is going to take, the first time that it is much, or half more."""
        needed, whole = (
            search_bytes(graph, measurement, shape, self.model, self.presence, most)
            for most in (self._most_bytes, math.inf))
        least = WORTH_TELLING_GB * BYTES_PER_GB if needed == whole else 0.0
        if needed > max(least, AGAIN * self._told_bytes):
            self._told_bytes = needed
            _LOG.info(
                'searching %d frames of %d x %d pixels takes %.2g GB of memory (max_memory_gb: '
                '%.2g)%s', graph.n_frames, shape[1], shape[0], needed / BYTES_PER_GB,
                self._most_bytes / BYTES_PER_GB, '' if needed == whole else
                f'; all at once it would take {whole / BYTES_PER_GB:.2g} GB')
