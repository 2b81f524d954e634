"""What the detectors that search a state graph share: the paths, their threshold, their frames."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import grid_shape
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.measurement.streak import StreakPsf
from track_before_detect.models.motion.range_doppler import build_range_doppler_graph
from track_before_detect.models.motion.state_graph import (
    build_state_graph,
    exact_stamps,
    regular_stamps,
    StateGraph,
)
from track_before_detect.models.presence import frames_seen_in, presence_for
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import usable_cores
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    median_interval,
)
from track_before_detect.solvers.calibration.calibration_cost import search_seconds
from track_before_detect.solvers.calibration.threshold import (
    noise_frames,
    NoiseStudy,
    threshold_for,
)
from track_before_detect.solvers.convex.working_set import WorkingSet
from track_before_detect.solvers.search.path_search import path_search, PathSearch, search_size
from track_before_detect.solvers.search.periodic_columns import (
    doppler_margin,
    in_frame,
    once_each,
    strip,
    strip_margin,
)
from track_before_detect.types import Progress

# Largest acceleration unless given: the maximum speed within this many frame intervals.
INTERVALS_TO_MAX_SPEED = 30
# The same over range-Doppler maps: one Doppler bin within this many.
INTERVALS_TO_NEXT_DOPPLER = 10
# Decimals of a median interval to which the moments of range-Doppler maps are known.
DOPPLER_TIME_DIGITS = 3
# Memory for the tables of one search, and comparisons made to fill them (some seconds of one
# core); a wider search is cut down to fit.
MOST_TABLE_BYTES = 2 * 2**30
MOST_COMPARISONS = 8e9
WIDEST_DISC = 60

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Task:
    """One batch, ready to be searched.

    Attributes
    ----------
    graph : StateGraph
        The paths.
    search : PathSearch
        Finds the best of them.
    paths : WorkingSet
        Holds the frames; starts empty.
    times : array, shape (T,)
        In the unit of time of the graph.
    weights : float32 array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel, zero where masked; of no frames where it is one.
    psf : Psf or MultiSensor
        What a target looks like in these frames.
    """

    graph: StateGraph
    search: PathSearch
    paths: WorkingSet
    times: NDArray[np.float64]
    weights: NDArray[np.float32]
    psf: Psf | MultiSensor


class PathDetector(BatchDetector):
    """Finds trajectories among the paths of a state graph.

    Parameters
    ----------
    options : DetectorOptions
        Motion, PSF, amplitudes and threshold.
    view : MultiSensor, optional
        How the frames of the one batch that is then searched see a common plane; without it all
        batches come from one sensor, in its own pixels.
    """

    takes_any_psf = True
    weighs_pixels = True
    knows_streaks = True
    # Best paths of noise whose positions are refined.
    refined_in_noise = 0

    def __init__(self, options: DetectorOptions, view: MultiSensor | None = None):
        super().__init__(options)
        self._view = view
        self.psf: Psf | MultiSensor = view or psf_of(options)
        self.model = AmplitudeModel.named(options.amplitudes, options.amplitude_model)
        _check_motion(options)
        _check_exposure(options, view)
        self.presence = presence_for(self.model) if options.presence == 'partial' else None
        self._kept_graph: tuple[tuple, StateGraph] | None = None
        self._search: tuple[tuple, PathSearch] | None = None
        self._warned = False

    def graph(self, stamps: NDArray, shape: tuple[int, int]) -> StateGraph:
        """Return the paths that are searched in frames of a shape taken at ``stamps`` (s).

        Where the search would take too much memory or time, the fastest motions are left out,
        with a warning.
        """
        key = (self._times(stamps).tobytes(), median_interval(stamps), shape)
        if self._kept_graph is None or self._kept_graph[0] != key:
            self._kept_graph = (key, self._new_graph(stamps, shape))
        return self._kept_graph[1]

    def _new_graph(self, stamps, shape):
        options = self.options
        interval = median_interval(stamps)
        if options.motion_model == 'range_doppler':
            return self._range_doppler_graph(stamps, shape)
        # A target that crosses the frame in one interval is as fast as can be seen, and the turns
        # that come with a larger speed would take for ever to search.
        speed = min(self.max_speed(stamps), float(np.hypot(*shape)) / interval)
        acceleration = options.max_acceleration_px_s2
        if acceleration is None:
            acceleration = speed / (INTERVALS_TO_MAX_SPEED * interval)
        if options.motion_model == 'constant_velocity':
            acceleration = 0.0
        # Three digits are finer than any grid and keep equal cameras on one calibration.
        speed, acceleration = (float(f'{value:.3g}') for value in (
            speed * interval, acceleration * interval**2))
        # A disc of velocities may be wider than can be searched.
        velocity_step = self._graph(stamps, min(speed, 1e-9), acceleration).velocity_step
        fitting = min(speed, WIDEST_DISC * velocity_step)
        graph = self._graph(stamps, fitting, acceleration)
        psf = self._seen_psf(stamps)
        while not self._affordable(graph, shape, psf):
            if graph.n_velocities == 1:
                raise ParameterError(
                    f'a batch of {len(stamps)} frames of {shape[1]} x {shape[0]} pixels is too '
                    f'large to search, even for targets that stand still: lower batch_length')
            fitting *= 0.95
            graph = self._graph(stamps, fitting, acceleration)
        if fitting < speed and not self._warned:
            self._warned = True
            _LOG.warning(
                'the search for speeds up to %.3g px/s would be too large; it is made up to '
                '%.3g px/s. A lower max_speed_px_s, max_acceleration_px_s2 or batch_length, or '
                'a wider psf_sigma_px, avoids this', speed / interval, fitting / interval)
        return graph

    def _graph(self, stamps, speed, acceleration):
        return build_state_graph(
            self._times(stamps), step_px=1 / self.psf.oversampling, max_speed=speed,
            max_acceleration=acceleration, turn_cost=self.model.turn_cost)

    def _times(self, stamps):
        """Return stamps in the unit of time of the graph."""
        if self.options.motion_model == 'range_doppler':
            # Many range bins pass in one interval, so the jitter of a clock shows.
            return np.round(exact_stamps(stamps), DOPPLER_TIME_DIGITS)
        return regular_stamps(stamps) if self._view is None else exact_stamps(stamps)

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return the threshold for batches of this shape, calibrating it where it is unknown."""
        if self._view is None or self.options.threshold is not None:
            return super().threshold(stamps, shape, progress)
        # The moments of several sensors matter, and which of them looked.
        return threshold_for(self.noise_study(stamps, shape), shape,
                             self.options.false_alarm_rate, progress)

    def _range_doppler_graph(self, stamps, shape):
        """Return the paths over range-Doppler maps."""
        options, interval = self.options, median_interval(stamps)
        assert options.range_bins_per_doppler_bin is not None
        rows_per_column = options.range_bins_per_doppler_bin * interval
        if abs(rows_per_column) > shape[0]:
            raise ParameterError(
                'range_bins_per_doppler_bin must move a target by at most the height of a map, '
                f'{shape[0]} bins, in one interval of {interval:g} s, got '
                f'{options.range_bins_per_doppler_bin:g} bins/s')
        acceleration = options.max_acceleration_px_s2
        if acceleration is None:
            acceleration = abs(rows_per_column) / (INTERVALS_TO_NEXT_DOPPLER * interval**2)
        # Crossing all Doppler bins in one interval is as fast as can be seen.
        acceleration = min(acceleration, abs(rows_per_column) * shape[1] / interval**2)
        margin = self._doppler_margin(shape[1])
        graph = build_range_doppler_graph(
            self._times(stamps), step_px=1 / self.psf.oversampling,
            rows_per_column=float(f'{rows_per_column:.3g}'),
            still_column=margin + shape[1] // 2 + options.doppler_offset_bins,
            max_acceleration=float(f'{acceleration * interval**2:.3g}'),
            turn_cost=self.model.turn_cost)
        if not self._affordable(graph, (shape[0], shape[1] + 2 * margin)):
            raise ParameterError(
                f'a batch of {len(stamps)} maps of {shape[0]} x {shape[1]} bins is too large to '
                f'search for accelerations up to {acceleration:.3g} bins/s^2: lower '
                'max_acceleration_px_s2, doppler_ambiguities or batch_length')
        return graph

    def _affordable(self, graph: StateGraph, shape: tuple[int, int],
                    psf: Psf | MultiSensor | None = None) -> bool:
        memory, states = search_size(graph, psf or self.psf, shape, self.presence)
        return (memory <= MOST_TABLE_BYTES
                and states * (1 + 4 * graph.reach) <= MOST_COMPARISONS)

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic of any path in noise."""
        graph = self.graph(stamps, shape)

        margin, psf = self._margin(graph, shape[1]), self._seen_psf(stamps)
        doppler = graph.coupling is not None
        times = self._times(stamps)

        def searcher(crop):
            view = self._view.window(crop) if self._view else None
            searched = (crop[0], crop[1] + 2 * margin)
            seen_as = view or psf
            search = self._new_search(graph, seen_as, searched, 1)
            largest_value = self.largest_value(search, seen_as, times)
            pixels = view.frame_shape if view else crop

            def largest(generator):
                noise = noise_frames(generator, (graph.n_frames, *pixels),
                                     self.model.is_complex)
                return self.statistic(largest_value(strip(noise, margin)), graph.n_frames)

            return largest

        def area(size):
            # Doppler that is ambiguous is searched in every column of the strip.
            return graph.effective_area((size[0], size[1] + 2 * margin * doppler), margin > 0)

        def seconds(crop):
            grid = grid_shape(self.psf, (crop[0], crop[1] + 2 * margin))
            return search_seconds(graph, psf, grid, self.model, self.presence is not None,
                                  self.refined_in_noise)

        return NoiseStudy(
            f'{type(self).__name__} {graph.fingerprint()} {psf.key} {self.model} '
            f'{self.presence} {margin > 0}', area, searcher, doppler, seconds,
            decay=1.0 if self.model.is_complex else 0.5)

    def largest_value(self, search: PathSearch, psf: Psf | MultiSensor, times: NDArray,
                      ) -> Callable[[NDArray], float]:
        """Return a function that returns the largest value of any path in frames of noise.

        Parameters
        ----------
        search : PathSearch
            The paths.
        psf : Psf or MultiSensor
            What a target looks like there.
        times : array, shape (T,)
            In the unit of time of the graph.
        """
        return search.best_value

    def _margin(self, graph, width):
        """Return the columns that frames are continued by beyond a seam, 0 without one."""
        if isinstance(self.psf, MultiSensor):
            return 0
        if self.options.motion_model == 'range_bearing':
            return strip_margin(graph, width, self.psf)
        return self._doppler_margin(width)

    def _doppler_margin(self, width):
        assert not isinstance(self.psf, MultiSensor)
        return doppler_margin(self.options.doppler_ambiguities, width, self.psf)

    def detect(self, frames: NDArray, stamps: NDArray,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories."""
        return self.detect_weighted(frames, stamps, None, progress)

    def detect_weighted(self, frames: NDArray, stamps: NDArray, weights: NDArray | None,
                        progress: Progress | None = None) -> BatchResult:
        """Find the trajectories where the noise differs between pixels."""
        self.check_kind(frames)
        shape = self._view.shape if self._view else frames.shape[1:]
        graph = self.graph(stamps, shape)
        threshold = self.threshold(stamps, shape, progress)
        margin = self._margin(graph, shape[1])
        frames = np.ascontiguousarray(
            strip(frames, margin), np.complex64 if self.model.is_complex else np.float32)
        if weights is not None:
            weights = strip(np.asarray(weights), margin)
        valid = np.isfinite(frames)
        if not valid.all():
            frames = np.where(valid, frames, frames.dtype.type(0))
            weights = valid.astype(np.float32) if weights is None else weights * valid
        searched = self._view.shape if self._view else frames.shape[1:]
        psf = self._seen_psf(stamps)
        search = self._path_search(graph, psf, searched, weights)
        if weights is None:
            weights = np.zeros((0, 0, 0), np.float32)
        weights = np.ascontiguousarray(weights, np.float32)
        ambiguous = self.options.doppler_ambiguities > 0
        paths = WorkingSet(frames, weights, psf, self._weight(threshold, len(frames)),
                        self.model, shape[1] if ambiguous else None)
        result = self.solve(Task(graph, search, paths, self._times(stamps), weights, psf))
        if margin:
            in_columns = in_frame if ambiguous else once_each
            result = replace(result, found=in_columns(result.found, margin, shape[1]))
        return result

    def statistic(self, value: float, n_frames: int) -> float:
        """Return the statistic of a path that is compared with the threshold.

        It is that of a path of equal value which is present in every frame, so that a threshold
        means the same whether targets may enter and leave or not.
        """
        whole = self.presence.whole_cost(n_frames) if self.presence else 0.0
        return self.model.from_value(value + whole)

    def present(self, positions: NDArray, seen: NDArray) -> NDArray[np.bool_]:
        """Return in which frames (T,) the target of a path is reported.

        Parameters
        ----------
        positions : array, shape (T, 2)
            NaN where the path is absent.
        seen : array, shape (T,)
            Statistic of each frame along it.
        """
        present = np.isfinite(positions[:, 0])
        if self.presence is not None:
            [frames] = np.nonzero(present)
            inside = self.model.rectified(seen[frames])
            first, last = frames_seen_in(inside)
            present[:frames[first]] = False
            present[frames[last] + 1:] = False
        return present

    def _weight(self, threshold, n_frames):
        """Return lambda of a path without any cost."""
        if self.presence is None:
            return threshold
        whole = self.presence.whole_cost(n_frames)
        if threshold**2 <= whole:
            raise ParameterError(
                f'threshold must be above {whole**0.5:.3g} for batches of {n_frames} frames with '
                f'presence partial, got {threshold:g}')
        return (threshold**2 - whole)**0.5

    @abstractmethod
    def solve(self, task: Task) -> BatchResult:
        """Find the paths of a batch."""

    def _seen_psf(self, stamps):
        """Return what a target looks like in frames taken at ``stamps``."""
        exposure = self.options.exposure_s
        if not exposure or len(stamps) == 1:
            return self.psf
        interval = median_interval(stamps)
        if exposure > interval:
            raise ParameterError(
                f'exposure_s must be at most the median interval of the frames, {interval:g} s, '
                f'got {exposure:g} s')
        assert isinstance(self.psf, Psf)
        share = float(f'{exposure / interval:.3g}')
        # A little more, for velocities between frames differ from those of the search.
        longest = 1.1 * share * self.max_speed(stamps) * interval
        return StreakPsf(self.psf, share, longest, tuple(self._times(stamps).tolist()))

    def _path_search(self, graph, psf, shape, weights):
        """Return the search for these paths, with its tables where the last one had them."""
        key = (shape, graph.fingerprint(), psf.key)
        if self._search is None or self._search[0] != key:
            self._search = (key, self._new_search(graph, psf, shape, usable_cores()))
        self._search[1].set_weights(weights)
        return self._search[1]

    def _new_search(self, graph: StateGraph, psf: Psf | MultiSensor, shape: tuple[int, int],
                    n_threads: int) -> PathSearch:
        return path_search(graph, psf, shape, self.model, self.presence, n_threads)


def _check_exposure(options, view):
    """Refuse what streaks cannot be combined with."""
    if not options.exposure_s:
        return
    for name, allowed in (
            ('motion_model', ('nearly_constant_velocity', 'constant_velocity', 'static')),
            ('registration', ('none',)), ('presence', ('full',)),
            ('amplitude_model', ('fluctuating',))):
        if getattr(options, name) not in allowed:
            raise ParameterError(f'exposure_s above 0 needs {name} {" or ".join(allowed)}, got '
                                 f'{getattr(options, name)}')
    if view is not None:
        raise ParameterError(
            f'exposure_s must be 0 for several sensors, got {options.exposure_s:g} s')
    if options.continuation[-1] == 1.0:
        raise ParameterError(
            'exposure_s above 0 needs a continuation that ends below 1: streaks are searched by '
            'shapes that are near to theirs, which a certificate over all paths cannot rest on')


def _check_motion(options):
    """Refuse options that the motion model cannot honour."""
    if options.motion_model == 'range_doppler':
        if not options.range_bins_per_doppler_bin:
            raise ParameterError(
                'motion_model range_doppler needs range_bins_per_doppler_bin other than 0, got '
                f'{options.range_bins_per_doppler_bin}')
        if options.max_speed_px_s is not None:
            raise ParameterError(
                'max_speed_px_s must be left out with motion_model range_doppler, whose Doppler '
                f'bins say how fast a target is, got {options.max_speed_px_s:g}')
    around = options.motion_model == 'range_bearing' or options.doppler_ambiguities > 0
    if around and options.registration != 'none':
        raise ParameterError(
            f'registration must be none with motion_model {options.motion_model}, whose columns '
            f'go round, got {options.registration}')
