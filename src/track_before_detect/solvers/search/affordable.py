"""Whether the search of a state graph fits into memory and time."""

import math

import numpy as np

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import grid_shape, MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.sheared_scores import sheared_shape
from track_before_detect.solvers.search.viterbi_table import table_bytes

# Comparisons made to fill the tables of one search (some seconds of one core); a wider search is
# cut down to fit.
MOST_COMPARISONS = 8e9


def search_bytes(graph: StateGraph, measurement: MeasurementModel, shape: tuple[int, int],
                 amplitudes: AmplitudeModel, presence: Presence | None,
                 most_bytes: float = math.inf) -> int:
    """Return the memory that a search on a plane of a size (H, W) takes: scores and tables.

    Parameters
    ----------
    graph, measurement, shape, amplitudes, presence
        As of ``path_search``.
    most_bytes : float
        Memory that it may take; it takes more where it has to.
    """
    n_signs, n_kinds = len(amplitudes.signs), _n_kinds(graph, measurement)
    table = table_bytes(graph, sheared_shape(graph, grid_shape(measurement, shape)), presence,
                        n_kinds, table_share(graph, measurement, shape, amplitudes, most_bytes))
    return n_signs * (_score_bytes(graph, measurement, shape) + table)


def table_share(graph: StateGraph, measurement: MeasurementModel, shape: tuple[int, int],
                amplitudes: AmplitudeModel, most_bytes: float) -> float:
    """Return what each table of a search may take of its memory; see :func:`search_bytes`."""
    return most_bytes / len(amplitudes.signs) - _score_bytes(graph, measurement, shape)


def _n_kinds(graph: StateGraph, measurement: MeasurementModel) -> int:
    """Return how many scores there are: streaks of each shape have their own."""
    return measurement.search_work(graph, False).n_kinds


def _score_bytes(graph: StateGraph, measurement: MeasurementModel,
                 shape: tuple[int, int]) -> int:
    """Return the memory of the scores of one sign."""
    grid = sheared_shape(graph, grid_shape(measurement, shape))
    return 4 * _n_kinds(graph, measurement) * graph.n_frames * int(np.prod(grid))


def affordable(graph: StateGraph, measurement: MeasurementModel, shape: tuple[int, int],
               amplitudes: AmplitudeModel, presence: Presence | None, most_bytes: float) -> bool:
    """Return whether the paths of a graph can be searched on a plane of a size (H, W)."""
    grid = sheared_shape(graph, grid_shape(measurement, shape))
    states = graph.n_segments * graph.n_velocities * float(np.prod(grid))
    return (states * (1 + 4 * graph.reach) <= MOST_COMPARISONS
            and search_bytes(graph, measurement, shape, amplitudes, presence,
                             most_bytes) <= most_bytes)
