"""Search of the best paths for given frames over all paths of a state graph (Patent Eq. 16-22).

A path wins by a sum over its frames (of squared positive statistics, in the simplest case) less
the cost of its turns, the largest of which is found by dynamic programming. For a group lasso with
weights lambda_path^2 = lambda^2 + cost(path) this is the worst violator of the optimality
conditions: a value above lambda^2 is a path that lowers the objective, and when there is none the
solution at hand is optimal.

A search is made of three parts: scores say what a position adds, a table holds the best path to
every state, and a functional says what is to be largest of a path.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import grid_shape, MeasurementModel, Scores
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.additive import Additive
from track_before_detect.solvers.search.affordable import table_share
from track_before_detect.solvers.search.coarse_to_fine import path_table
from track_before_detect.solvers.search.ratio import Ratio
from track_before_detect.solvers.search.sheared_scores import ShearedScores
from track_before_detect.solvers.search.viterbi_table import RowThreads


@dataclass(frozen=True)
class FoundPath:
    """A path over the state graph.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y in pixels, NaN in frames where it is absent.
    value : float
        Sum over the frames, as the amplitude model has it, less the cost.
    cost : float
        Cost of the turns, and of being present where that has one.
    """

    positions: NDArray[np.float64]
    value: float
    cost: float


class PathSearch:
    """Finds the best paths in frames of one size and one set of stamps; see :func:`path_search`.

    Parameters
    ----------
    scores : Scores
        What a position adds to the value of a path.
    graph, model, presence, n_threads
        As there.
    most_bytes : float
        Memory for each table; see ``ViterbiTable``.
    few_pass : bool
        As there.
    """

    def __init__(self, graph: StateGraph, scores: Scores, model: AmplitudeModel,
                 presence: Presence | None = None, n_threads: int = 1,
                 most_bytes: float = math.inf, few_pass: bool = True):
        self.graph = graph
        self.model = model
        self.grid_shape = scores.grid_shape
        self._scores = scores
        self._presence = presence
        tables = [(sign, path_table(graph, scores.grid_shape, n_threads, scores.kinds, presence,
                                    most_bytes, few_pass)) for sign in model.signs]
        self._additive = Additive(scores, tables, presence)
        self._ratio = Ratio(scores, tables, presence)

    def set_weights(self, weights: NDArray | None) -> None:
        """Tell one over the noise of each pixel of a new batch; None when all are one.

        Parameters
        ----------
        weights : array, shape (T, H, W) or (1, H, W), or None
            Zero where masked.
        """
        self._scores.set_weights(weights)
        self.forget()

    def forget(self) -> None:
        """Search the next frames without looking for what they share with the last."""
        self._additive.forget()

    def best_value(self, frames: NDArray) -> float:
        """Return the largest value of any path, 0 when a ratio has none above."""
        return self._functional.largest(frames)

    def best_paths(self, frames: NDArray, above: float, separation: float, limit: int,
                   chosen: Callable[[NDArray], Iterable[int]] | None = None,
                   ) -> tuple[float, list[FoundPath]]:
        """Return the largest value of any path, and separate paths with values above a bound.

        The bound may be returned in place of a largest value below it.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            Frames of unit noise, masked pixels zero.
        above : float
            Only paths of larger value are returned.
        separation : float
            Pixels between the last positions of two paths that are both traced.
        limit : int
            Most paths that are traced.
        chosen : callable, optional
            Told the positions (N, T, 2) of paths, the best first, tells the numbers of those that
            are worth returning; all are unless given.
        """
        radius = max(1, round(separation / self.graph.step_px))
        largest, traced = self._functional.best(frames, above, radius, limit)
        if not traced:
            return largest, []
        traced.sort(key=lambda path: -path.value)
        positions = np.stack([path.positions for path in traced])
        there = np.isfinite(positions[..., 0])
        positions[there] = self._scores.restore(positions[there], np.nonzero(there)[1])
        positions *= self.graph.step_px
        costs = [path.turn_cost for path in traced]
        if self._presence:
            n_frames = positions.shape[1]
            first, beyond = there.argmax(axis=1), n_frames - there[:, ::-1].argmax(axis=1)
            costs = [cost + self._presence.cost(int(begin), int(end) - 1, n_frames)
                     for cost, begin, end in zip(costs, first, beyond, strict=True)]
        numbers = range(len(traced)) if chosen is None else chosen(positions)
        return largest, [FoundPath(positions[number], traced[number].value, costs[number])
                         for number in itertools.islice(numbers, limit)]

    @property
    def _functional(self) -> Additive | Ratio:
        """What is to be largest: a constant amplitude is weighed by the norm of its column.

        That differs between paths where pixels are weighed, and where they differ in length.
        """
        uneven = self._presence is not None or self._scores.squares is not None
        return self._ratio if self.model.is_constant and uneven else self._additive


def path_search(graph: StateGraph, measurement: MeasurementModel, shape: tuple[int, int],
                amplitudes: AmplitudeModel, presence: Presence | None = None,
                n_threads: int = 1, most_bytes: float = math.inf,
                few_pass: bool = True) -> PathSearch:
    """Return the search for the paths of a graph in frames of one size.

    Parameters
    ----------
    graph : StateGraph
        The paths; its step has to match the oversampling of the measurement model.
    measurement : MeasurementModel
        How frames see the positions.
    shape : tuple of int
        (H, W) of the frames, or of the plane that they see.
    amplitudes : AmplitudeModel
        Says what a statistic is worth.
    presence : Presence, optional
        Cost of being present, where targets may enter and leave during the batch.
    n_threads : int
        Threads that share the rows of the frames.
    most_bytes : float
        Memory that scores and tables may take; see ``search_bytes``.
    few_pass : bool
        Whether few paths pass the levels that are asked for, as those of noise do.
    """
    over_rows = RowThreads(grid_shape(measurement, shape)[0], n_threads)
    scores = measurement.scores(graph, shape, amplitudes, over_rows)
    if graph.coupling is not None:
        scores = ShearedScores(scores, graph)
    return PathSearch(graph, scores, amplitudes, presence, n_threads, table_share(
        graph, measurement, shape, amplitudes, most_bytes), few_pass)
