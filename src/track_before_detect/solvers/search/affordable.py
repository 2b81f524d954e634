"""Whether the search of a state graph fits into memory and time."""

import numpy as np

from track_before_detect.models.measurement.base import grid_shape, MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.sheared_scores import sheared_shape
from track_before_detect.solvers.search.viterbi_table import table_bytes

# Memory for the tables of one search, and comparisons made to fill them (some seconds of one
# core); a wider search is cut down to fit.
MOST_TABLE_BYTES = 2 * 2**30
MOST_COMPARISONS = 8e9


def affordable(graph: StateGraph, measurement: MeasurementModel, shape: tuple[int, int],
               presence: Presence | None) -> bool:
    """Return whether the paths of a graph can be searched on a plane of a size (H, W)."""
    grid = sheared_shape(graph, grid_shape(measurement, shape))
    memory = table_bytes(graph, grid, presence)
    n_kinds = measurement.search_work(graph, False).n_kinds
    if n_kinds > 1:
        # Streaks of each shape have scores of their own, which the table copies.
        memory += 8 * n_kinds * graph.n_frames * int(np.prod(grid))
    states = graph.n_segments * graph.n_velocities * float(np.prod(grid))
    return (memory <= MOST_TABLE_BYTES
            and states * (1 + 4 * graph.reach) <= MOST_COMPARISONS)
