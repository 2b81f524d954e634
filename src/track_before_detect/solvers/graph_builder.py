"""Which paths a detector searches: the bounds of the options, cut to what can be searched."""

import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.range_doppler import build_range_doppler_graph
from track_before_detect.models.motion.state_graph import (
    build_state_graph,
    exact_stamps,
    regular_stamps,
    StateGraph,
)
from track_before_detect.models.presence import Presence
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import searched_speed
from track_before_detect.solvers.search.affordable import affordable
from track_before_detect.solvers.search.memory import BYTES_PER_GB
from track_before_detect.timestamps import median_interval

# Largest acceleration unless given: the maximum speed within this many frame intervals.
INTERVALS_TO_MAX_SPEED = 30
# The same over range-Doppler maps: one Doppler bin within this many.
INTERVALS_TO_NEXT_DOPPLER = 10
# Decimals of a median interval to which the moments of range-Doppler maps are known.
DOPPLER_TIME_DIGITS = 3
# Velocity steps from the middle of the widest disc of velocities that is tried.
WIDEST_DISC = 60

_LOG = logging.getLogger(__name__)


class GraphBuilder:
    """Builds the state graph for the frames of a batch, and keeps the last one.

    Parameters
    ----------
    options : DetectorOptions
        Motion model and its bounds.
    amplitudes : AmplitudeModel
        Says what a turn costs.
    presence : Presence or None
        Cost of being present, where targets may enter and leave.
    most_bytes : float
        Memory that a search may take.
    """

    def __init__(self, options: DetectorOptions, amplitudes: AmplitudeModel,
                 presence: Presence | None, most_bytes: float):
        self._options = options
        self._amplitudes = amplitudes
        self._presence = presence
        self._most_bytes = most_bytes
        self._kept: tuple[tuple, StateGraph] | None = None
        self._warned = False

    def times(self, stamps: NDArray, measurement: MeasurementModel) -> NDArray[np.float64]:
        """Return stamps (s) in the unit of time of the graph, the median interval."""
        if self._options.motion_model == 'range_doppler':
            # Many range bins pass in one interval, so the jitter of a clock shows.
            return np.round(exact_stamps(stamps), DOPPLER_TIME_DIGITS)
        return exact_stamps(stamps) if measurement.exact_times else regular_stamps(stamps)

    def graph(self, stamps: NDArray, measurement: MeasurementModel, shape: tuple[int, int],
              margin: int = 0) -> StateGraph:
        """Return the paths that are searched in frames of a shape taken at ``stamps`` (s).

        Where the search would take too much memory or time, the fastest motions are left out,
        with a warning.

        Parameters
        ----------
        stamps : array, shape (T,)
            Seconds.
        measurement : MeasurementModel
            How the frames see positions.
        shape : tuple of int
            (H, W) of the positions' plane.
        margin : int
            Columns that range-Doppler maps go on for at each side.
        """
        key = (self.times(stamps, measurement).tobytes(), median_interval(stamps), shape,
               measurement.key)
        if self._kept is None or self._kept[0] != key:
            if self._options.motion_model == 'range_doppler':
                graph = self._range_doppler_graph(stamps, measurement, shape, margin)
            else:
                graph = self._plane_graph(stamps, measurement, shape)
            self._kept = (key, graph)
        return self._kept[1]

    def _plane_graph(self, stamps: NDArray, measurement: MeasurementModel,
                     shape: tuple[int, int]) -> StateGraph:
        options, interval = self._options, median_interval(stamps)
        times = self.times(stamps, measurement)
        speed = searched_speed(options, stamps, shape)
        acceleration = options.max_acceleration_px_s2
        if acceleration is None:
            acceleration = speed / (INTERVALS_TO_MAX_SPEED * interval)
        if options.motion_model == 'constant_velocity':
            acceleration = 0.0
        # Three digits are finer than any grid and keep equal cameras on one calibration.
        speed, acceleration = _digits(speed * interval), _digits(acceleration * interval**2)

        def up_to(fitting: float) -> StateGraph:
            return build_state_graph(
                times, step_px=1 / measurement.oversampling, max_speed=fitting,
                max_acceleration=acceleration, turn_cost=self._amplitudes.turn_cost)

        # A disc of velocities may be wider than can be searched.
        fitting = min(speed, WIDEST_DISC * up_to(min(speed, 1e-9)).velocity_step)
        graph = up_to(fitting)
        while not self._affordable(graph, measurement, shape):
            if graph.n_velocities == 1:
                raise ParameterError(
                    f'a batch of {len(stamps)} frames of {shape[1]} x {shape[0]} pixels is too '
                    f'large to search, even for targets that stand still: lower batch_length or '
                    f'raise max_memory_gb, {self._most_bytes / BYTES_PER_GB:.3g} now')
            fitting *= 0.95
            graph = up_to(fitting)
        if fitting < speed and not self._warned:
            self._warned = True
            _LOG.warning(
                'the search for speeds up to %.3g px/s would be too large; it is made up to '
                '%.3g px/s. A lower max_speed_px_s, max_acceleration_px_s2 or batch_length, or '
                'a wider psf_sigma_px, or a larger max_memory_gb where that is what is short '
                '(%.3g now), avoids this', speed / interval, fitting / interval,
                self._most_bytes / BYTES_PER_GB)
        return graph

    def _range_doppler_graph(self, stamps: NDArray, measurement: MeasurementModel,
                             shape: tuple[int, int], margin: int) -> StateGraph:
        options, interval = self._options, median_interval(stamps)
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
        graph = build_range_doppler_graph(
            self.times(stamps, measurement), step_px=1 / measurement.oversampling,
            rows_per_column=_digits(rows_per_column),
            still_column=margin + shape[1] // 2 + options.doppler_offset_bins,
            max_acceleration=_digits(acceleration * interval**2),
            turn_cost=self._amplitudes.turn_cost)
        if not self._affordable(graph, measurement, (shape[0], shape[1] + 2 * margin)):
            raise ParameterError(
                f'a batch of {len(stamps)} maps of {shape[0]} x {shape[1]} bins is too large to '
                f'search for accelerations up to {acceleration:.3g} bins/s^2: lower '
                'max_acceleration_px_s2, doppler_ambiguities or batch_length, or raise '
                'max_memory_gb')
        return graph

    def _affordable(self, graph: StateGraph, measurement: MeasurementModel,
                    shape: tuple[int, int]) -> bool:
        return affordable(graph, measurement, shape, self._amplitudes, self._presence,
                          self._most_bytes)


def _digits(value: float) -> float:
    return float(f'{value:.3g}')
