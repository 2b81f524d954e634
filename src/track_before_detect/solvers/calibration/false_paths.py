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
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.calibration.excursions import expected_islands
from track_before_detect.solvers.calibration.noise_study import FalsePaths
from track_before_detect.solvers.calibration.present_runs import PresentRuns

TABLE = 'false_paths.json'
# Level at which its correction is nothing, and turns that count as one.
LEVEL, TURNS = 5.0, 5
# Height and width of frames beyond what the fastest target travels, in widths of the PSF, from
# which on places are many enough for theory (docs/constants/calibration.md).
LEAST_ROOM = 16.0
# Kind whose corrections are those of all amplitudes that are not constant.
FLUCTUATING = 'NonNegative'
# Paths so few that what corrects them is of no interest.
LEAST = 1e-300


def modelled_false_paths(graph: StateGraph, psf: MeasurementModel, model: AmplitudeModel,
                         presence: Presence | None, shape: tuple[int, int],
                         table: Mapping[str, Any] | None = None) -> FalsePaths | None:
    """Return how many paths of noise pass a level, None beyond the options of the table.

    Parameters
    ----------
    graph : StateGraph
        Paths over a plane whose columns end, in frames at equal intervals.
    psf : MeasurementModel
        A Gaussian, the same in all frames.
    model : AmplitudeModel
        Of the amplitudes.
    presence : Presence or None
        What it costs to be there; None of targets that are there in every frame.
    shape : tuple of int
        (H, W) of the frames.
    table : mapping, optional
        That of the package unless given.
    """
    known = (_packaged() if table is None else table)['settings']
    coefficients = known['coefficients'].get(kind_of(model, presence))
    room = min(shape) / psf.width_px - _travel(graph, psf)
    if coefficients is None or room < LEAST_ROOM or not all(
            low <= value <= high for value, (low, high) in (
                (value, known['range'][name]) for name, value in extents(graph, psf).items())):
        return None
    weights = np.array(list(coefficients.values()))
    paths = StraightPaths(graph, psf, model, presence, shape, known['coefficients'])

    def false_paths(level: float) -> float:
        expected, left_out = paths.expected(level)
        return expected * math.exp(float(weights @ np.array(list(left_out.values()))))

    return false_paths


def kind_of(model: AmplitudeModel, presence: Presence | None) -> str:
    """Return the name of amplitudes and presence in the table.

    One amplitude of either sign passes as often as one of each sign, which theory knows.
    """
    one = model.is_constant and not model.is_complex
    name = 'Constant' if one else type(model).__name__
    return name if presence is None else f'{name}, partial'


def extents(graph: StateGraph, psf: MeasurementModel) -> dict[str, float]:
    """Return what the table is bounded by: frames, px, px a frame, widths, segments and steps."""
    found = {'frames': graph.n_frames, 'psf width': psf.width_px, 'segments': graph.n_segments,
             'steps of a turn': graph.reach}
    if graph.max_speed > 0:
        found |= {'speed': graph.max_speed, 'travel': _travel(graph, psf)}
    return found


def corrections(graph: StateGraph, psf: MeasurementModel, levels: NDArray,
                lengths: NDArray) -> dict[str, NDArray[np.float64]]:
    """Return what adds up, with the coefficients of the table, to the logarithm of a factor.

    Parameters
    ----------
    graph, psf
        As of :func:`modelled_false_paths`.
    levels : array, shape (R,)
        That are passed.
    lengths : array, shape (R,)
        By paths of so many frames.
    """
    turns = np.maximum(graph.n_segments * lengths / graph.n_frames - 1, 0) / TURNS
    coarse = graph.step_px / psf.width_px
    travel = np.maximum(graph.max_speed * (lengths - 1) / psf.width_px, 1.0)
    return {'all': np.ones_like(levels), 'level': np.log(np.maximum(levels, 1.0) / LEVEL),
            'turns': turns, 'turns squared': turns**2, 'coarse turns': turns * coarse,
            'coarse travel': coarse * np.log(travel)}


class StraightPaths:
    """Straight paths of noise in a batch, by theory.

    Parameters
    ----------
    graph, psf, model, presence, shape
        As of :func:`modelled_false_paths`.
    coefficients : mapping
        Those of the table by their kinds.
    """

    def __init__(self, graph: StateGraph, psf: MeasurementModel, model: AmplitudeModel,
                 presence: Presence | None, shape: tuple[int, int],
                 coefficients: Mapping[str, Mapping[str, float]]):
        self._graph, self._psf, self._model = graph, psf, model
        self._runs = PresentRuns(graph.n_frames, model, presence)
        # The kinds that were searched most correct those like them as well.
        base = FLUCTUATING if not model.is_constant else kind_of(model, None)
        self._of_all = None if kind_of(model, presence) == base else coefficients[base]
        length = math.sqrt(2) * psf.width_px
        rooms = [graph.rooms(shape, share=share) / length
                 for share in self._runs.lengths / graph.n_frames]
        self._places = np.array([(1.0, room.sum(axis=1).mean(), room.prod(axis=1).mean())
                                 for room in rooms]).T
        self._radius = graph.max_speed / length

    def expected(self, level: float) -> tuple[float, dict[str, float]]:
        """Return how many pass a level on average, and what corrects it, as ``corrections``."""
        model, runs = self._model, self._runs
        levels = runs.levels(level)
        islands = runs.counts * runs.chances(levels) * expected_islands(
            levels, runs.lengths, model.is_constant, not model.non_negative, self._places,
            self._radius)
        left_out = corrections(self._graph, self._psf, levels, runs.lengths)
        if self._of_all is None:
            return float(islands[0]), {name: float(value[0]) for name, value in left_out.items()}
        islands *= np.exp(sum(self._of_all[name] * value for name, value in left_out.items()))
        expected, found = float(islands.sum()), {'all': 1.0}
        if len(islands) > 1:
            # How many ends are inside the batch on average.
            found['ends'] = float(islands @ runs.ends) / max(expected, LEAST)
        return expected, found


def _travel(graph: StateGraph, psf: MeasurementModel) -> float:
    """Return how far the fastest target gets in a batch, in widths of the PSF."""
    return graph.max_speed * (graph.n_frames - 1) / psf.width_px


@lru_cache(maxsize=1)
def _packaged() -> Any:
    return json.loads(resources.files(__package__).joinpath(TABLE).read_text(encoding='utf-8'))
