"""How many paths of noise pass a level, without a search: theory and a table of its corrections.

Theory takes paths for straight and finds each one; see ``excursions``. What the grid, the turns
and the refinement make of it is a smooth correction, fitted to searches of noise with many options
by ``tbd evaluate false-paths``, whose summary is the table beside this module.
"""

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
import json
import math
from typing import Any

import numpy as np

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.calibration.excursions import expected_islands
from track_before_detect.solvers.calibration.noise_study import FalsePaths

TABLE = 'false_paths.json'
# Level at which its correction is nothing, and turns that count as one.
LEVEL, TURNS = 5.0, 5
# Height and width of frames beyond what the fastest target travels, in widths of the PSF, from
# which on places are many enough for theory (docs/constants/calibration.md).
LEAST_ROOM = 16.0


def modelled_false_paths(graph: StateGraph, psf: MeasurementModel, model: AmplitudeModel,
                         shape: tuple[int, int],
                         table: Mapping[str, Any] | None = None) -> FalsePaths | None:
    """Return how many paths of noise pass a level, None beyond the options of the table.

    Parameters
    ----------
    graph : StateGraph
        Paths over a plane whose columns end, in frames at equal intervals.
    psf : MeasurementModel
        A Gaussian at the middle of each pixel.
    model : AmplitudeModel
        Of targets that are there in every frame.
    shape : tuple of int
        (H, W) of the frames.
    table : mapping, optional
        That of the package unless given.
    """
    known = (_packaged() if table is None else table)['settings']
    coefficients = known['coefficients'].get(kind_of(model))
    room = min(shape) / psf.width_px - _travel(graph, psf)
    if coefficients is None or room < LEAST_ROOM or not all(
            low <= value <= high for value, (low, high) in (
                (value, known['range'][name]) for name, value in extents(graph, psf).items())):
        return None
    weights = np.array(list(coefficients.values()))

    def false_paths(level: float) -> float:
        left_out = np.array(list(corrections(graph, psf, level).values()))
        return (straight_paths(graph, psf, model, shape, level)
                * math.exp(float(weights @ left_out)))

    return false_paths


def kind_of(model: AmplitudeModel) -> str:
    """Return the name of an amplitude model in the table."""
    return type(model).__name__


def extents(graph: StateGraph, psf: MeasurementModel) -> dict[str, float]:
    """Return what the table is bounded by: frames, px, px a frame, widths, segments and steps."""
    found = {'frames': graph.n_frames, 'psf width': psf.width_px, 'segments': graph.n_segments,
             'steps of a turn': graph.reach}
    if graph.max_speed > 0:
        found |= {'speed': graph.max_speed, 'travel': _travel(graph, psf)}
    return found


def corrections(graph: StateGraph, psf: MeasurementModel, level: float) -> dict[str, float]:
    """Return what adds up, with the coefficients of the table, to the logarithm of a factor."""
    turns = (graph.n_segments - 1) / TURNS
    coarse = graph.step_px / psf.width_px
    return {'all': 1.0, 'level': math.log(level / LEVEL), 'turns': turns,
            'turns squared': turns**2, 'coarse turns': turns * coarse,
            'coarse travel': coarse * math.log(max(_travel(graph, psf), 1.0))}


def straight_paths(graph: StateGraph, psf: MeasurementModel, model: AmplitudeModel,
                   shape: tuple[int, int], level: float) -> float:
    """Return how many straight paths of noise pass a level in a batch on average, by theory."""
    length = math.sqrt(2) * psf.width_px
    rooms = graph.rooms(shape) / length
    return expected_islands(level, graph.n_frames, model.is_constant, not model.non_negative,
                            rooms, graph.max_speed / length)


def _travel(graph: StateGraph, psf: MeasurementModel) -> float:
    """Return how far the fastest target gets in a batch, in widths of the PSF."""
    return graph.max_speed * (graph.n_frames - 1) / psf.width_px


@lru_cache(maxsize=1)
def _packaged() -> Any:
    return json.loads(resources.files(__package__).joinpath(TABLE).read_text(encoding='utf-8'))
