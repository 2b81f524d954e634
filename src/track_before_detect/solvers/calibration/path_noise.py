"""The calibration study of a detector that searches the paths of a state graph."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.measurement.base import grid_shape, MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.calibration.calibration_cost import search_seconds
from track_before_detect.solvers.calibration.noise_study import (
    FalsePaths,
    noise_frames,
    NoiseStudy,
)
from track_before_detect.solvers.path_statistic import PathStatistic
from track_before_detect.solvers.search.periodic_columns import PeriodicColumns


def path_noise_study(name: str, graph: StateGraph, measurement: MeasurementModel,
                     columns: PeriodicColumns, scale: PathStatistic,
                     largest_value: Callable[[tuple[int, int]], Callable[[NDArray], float]],
                     n_refined: int, false_paths: FalsePaths | None) -> NoiseStudy:
    """Return how to find the largest statistic of any path in noise.

    Parameters
    ----------
    name : str
        Of the class of the detector.
    graph : StateGraph
        The paths.
    measurement : MeasurementModel
        What a target looks like.
    columns : PeriodicColumns
        Whether they go round.
    scale : PathStatistic
        What a value is worth.
    largest_value : callable
        Told (H, W) of a crop, returns a function that returns the largest value of any path in
        frames of it.
    n_refined : int
        Paths whose positions are refined.
    false_paths : callable, optional
        How many paths of noise pass a level; see :class:`NoiseStudy`.
    """
    model, margin = scale.amplitudes, columns.margin
    coupled = graph.coupling is not None

    def searcher(crop: tuple[int, int]) -> Callable[[np.random.Generator], float]:
        largest = largest_value(crop)
        pixels = measurement.window(crop).frame_shape(crop)

        def draw(generator: np.random.Generator) -> float:
            noise = noise_frames(generator, (graph.n_frames, *pixels), model.is_complex)
            return scale.statistic(largest(columns.strip(noise)), graph.n_frames)

        return draw

    def area(size: tuple[int, int]) -> float:
        # Doppler that is ambiguous is searched in every column of the strip.
        return graph.effective_area(columns.plane(size) if coupled else size, margin > 0)

    def seconds(crop: tuple[int, int]) -> float:
        grid = grid_shape(measurement, columns.plane(crop))
        return search_seconds(graph, measurement, grid, model, scale.presence is not None,
                              n_refined)

    return NoiseStudy(
        f'{name} {graph.fingerprint()} {measurement.key} {model} {scale.presence} {margin > 0}',
        area, searcher, coupled, seconds, decay=1.0 if model.is_complex else 0.5,
        false_paths=false_paths)
