"""Search of the best paths for given frames over all paths of a state graph (Patent Eq. 16-22).

A path wins by a sum over its frames (of squared positive statistics, in the simplest case) less
the cost of its turns, the largest of which is found by dynamic programming. For a group lasso with
weights lambda_path^2 = lambda^2 + cost(path) this is the worst violator of the optimality
conditions: a value above lambda^2 is a path that lowers the objective, and when there is none the
solution at hand is optimal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.measurement.streak import StreakPsf, streaks_of
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.search.mapped_scores import MappedScores
from track_before_detect.solvers.search.position_scores import grid_shape, PositionScores
from track_before_detect.solvers.search.sheared_plane import ShearedPlane
from track_before_detect.solvers.search.streak_scores import StreakScores
from track_before_detect.solvers.search.viterbi_table import ViterbiTable

NOTHING = np.empty((0, 0, 0), np.float32)


@dataclass(frozen=True)
class FoundPath:
    """A path over the state graph.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y in pixels.
    value : float
        Sum over the frames, as the amplitude model has it, less the cost of the turns.
    cost : float
        Cost of the turns.
    """

    positions: NDArray[np.float64]
    value: float
    cost: float


class PathSearch:
    """Finds the best paths in frames of one size and one set of stamps.

    Parameters
    ----------
    graph : StateGraph
        The paths.
    psf : Psf or MultiSensor
        Its oversampling has to match the step of the graph.
    shape : tuple of int
        (H, W) of the frames, or of the plane that a view looks at.
    model : AmplitudeModel
        Says what a position adds to the value of a path.
    n_threads : int
        Threads that share the rows of the frames.
    """

    def __init__(self, graph: StateGraph, psf: Psf | MultiSensor, shape: tuple[int, int],
                 model: AmplitudeModel, n_threads: int = 1):
        self.model = model
        self.graph = graph
        # Scores are computed on the grid of the frames and searched on grid_shape.
        frame_grid = grid_shape(psf, shape)
        self._plane = ShearedPlane(graph, frame_grid) if graph.coupling else None
        self.grid_shape = self._plane.shape if self._plane else frame_grid
        streaks, kind = streaks_of(graph, psf) if isinstance(psf, StreakPsf) else (None, None)
        self._table = ViterbiTable(graph, self.grid_shape, n_threads, kind)
        over_rows = (
            (lambda work: work(0, frame_grid[0])) if self._plane else self._table.over_rows)
        self._scores: PositionScores | MappedScores
        if isinstance(psf, MultiSensor):
            self._scores = MappedScores(psf, model, over_rows)
        elif isinstance(psf, StreakPsf):
            assert streaks is not None
            self._scores = StreakScores(psf, shape, model, over_rows, streaks)
        else:
            self._scores = PositionScores(psf, shape, model, over_rows)
        # The frames searched last and their scores, of no frames when nothing is known.
        self._seen = self._kept = NOTHING

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
        self._table.forget()
        self._seen = NOTHING

    def scores(self, frames: NDArray) -> NDArray:
        """Return what every position adds to the value of a path, shape (T, Y, X)."""
        return self._sheared(self._scores.scores(frames))

    def run(self, scores: NDArray) -> NDArray:
        """Compute all path weights; return the best by start of the last segment, (Y, X)."""
        self._table.fill(scores)
        self._seen = NOTHING
        return self._table.best

    def best_value(self, frames: NDArray) -> float:
        """Return the largest value of any path."""
        return float(self.run(self.scores(frames)).max())

    def best_paths(self, frames: NDArray, above: float, separation: float,
                   is_new: Callable[[NDArray], bool], limit: int,
                   ) -> tuple[float, list[FoundPath]]:
        """Return the largest value of any path, and separate paths with values above a bound.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            Frames of unit noise, masked pixels zero.
        above : float
            Only paths of larger value are returned.
        separation : float
            Pixels between the last positions of two paths that are both traced.
        is_new : callable
            Told the positions (T, 2) of a path, says whether it is worth returning.
        limit : int
            Most paths that are traced.
        """
        largest = self._update(frames, above)
        radius = max(1, round(separation / self.graph.step_px))
        return largest, [path for path in self._paths_of(self._table, above, radius, limit)
                         if is_new(path.positions)]

    def _paths_of(self, table, above, radius, limit):
        """Return the paths of the largest values above a bound, their starts apart."""
        peaks = table.peaks(above, radius, limit)
        traced, costs = table.trace(peaks)
        found = []
        for (y, x), positions, cost in zip(peaks, traced, costs, strict=True):
            if self._plane:
                positions = self._plane.restore(positions, np.arange(len(positions)))
            found.append(FoundPath(positions * self.graph.step_px, float(table.best[y, x]),
                                   float(cost)))
        return found

    def _sheared(self, scores):
        """Return scores of the frames' grid as they are searched."""
        return self._plane.shear(scores) if self._plane else scores

    def _update(self, frames, above):
        """Search frames, of which often only the rows around targets differ from the last."""
        if self._plane or isinstance(self._scores, (MappedScores, StreakScores)):
            return self._table.update(self.scores(frames), above)
        if self._seen.shape != frames.shape:
            self._kept = self._scores.scores(frames)
            self._seen = frames.copy()
            return self._table.update(self._kept, above)
        changed = np.array([np.any(new != old, axis=1)
                            for new, old in zip(frames, self._seen, strict=True)])
        rows = self._scores.renew(self._kept, frames, changed)
        self._seen[changed] = frames[changed]
        return self._table.update(self._kept, above, rows)


def path_search(graph: StateGraph, measurement: Psf | MultiSensor, shape: tuple[int, int],
                amplitudes: AmplitudeModel, presence: object = None,
                n_threads: int = 1) -> PathSearch:
    """Return the search."""
    from track_before_detect.solvers.search.constant_partial_search import ConstantPartialSearch
    from track_before_detect.solvers.search.constant_search import ConstantSearch
    from track_before_detect.solvers.search.partial_search import PartialSearch
    if presence is None:
        full = ConstantSearch if amplitudes.is_constant else PathSearch
        return full(graph, measurement, shape, amplitudes, n_threads)
    partial = ConstantPartialSearch if amplitudes.is_constant else PartialSearch
    return partial(graph, measurement, shape, amplitudes, presence, n_threads)
