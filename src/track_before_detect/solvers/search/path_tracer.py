"""Follows paths back through a table of which not all states may be held."""

from collections.abc import Iterator, Sequence
import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.search import viterbi, viterbi_backtrack
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.search.path_cone import (
    ConeRoom,
    NO_STATES,
    PathCone,
    place_of_cone,
)


class TracedPath(NamedTuple):
    """A path on the grid that is searched.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y in grid steps, NaN where the path is absent.
    velocities : array of int, shape (T,)
        Number of the velocity in each frame where it is present.
    value : float
        Its weight.
    turn_cost : float
        Cost of its turns.
    """

    positions: NDArray[np.float64]
    velocities: NDArray[np.int64]
    value: float
    turn_cost: float

    @property
    def frames(self) -> NDArray[np.int64]:
        """Numbers of the frames where the path is present."""
        return np.flatnonzero(np.isfinite(self.positions[:, 0]))


class PathTracer:
    """Finds the states of the best paths to given places.

    Where the states before an end are held, the path is followed as far back as they are, and only
    what may lead to the one state where it is then is computed anew. Otherwise all is that may
    lead to the end, for neighbouring ends together.

    Parameters
    ----------
    graph : StateGraph
        The paths.
    layout, motion, segments, end_costs
        The graph, as the compiled loops know it.
    whole : array of bool, shape (J - 1,)
        Which segments are held.
    """

    def __init__(self, graph: StateGraph, layout: viterbi.Layout,
                 motion: viterbi_backtrack.Motion, segments: Sequence[viterbi.Segment],
                 end_costs: Sequence[viterbi.EndCosts | None], whole: NDArray[np.bool_]):
        self._graph, self._layout, self._motion = graph, layout, motion
        self._segments, self._end_costs, self._whole = segments, end_costs, whole
        # By last segment, and by that and its velocity.
        self._cones: dict[tuple[int, int | None], PathCone] = {}
        self._scores = self._tables = NO_STATES
        self._places = np.empty((0, 0, 0), np.int64)
        self._rooms: dict[str, ConeRoom] = {}
        self._wide_place: tuple[int, ...] = ()

    def begin(self, scores: NDArray, tables: NDArray, places: NDArray[np.int64]) -> None:
        """Trace paths of these scores and tables from now on."""
        self._scores, self._tables, self._places = scores, tables, places
        self._wide_place = ()

    def trace(self, j: int, ends: NDArray[np.int64],
              ) -> tuple[list[TracedPath], NDArray[np.int64]]:
        """Return the best paths that start their last segment j at y and x, ``ends`` (N, 2).

        All at once, for a call of a compiled loop takes longer than to follow a path.

        Returns
        -------
        paths : list of TracedPath
        starts : array of int, shape (N, J, 2)
            x and y of their starts of segments, also of those that they would go on to.
        """
        n_ends, n_frames = len(ends), self._graph.n_frames
        positions = np.full((n_ends, n_frames, 2), np.nan)
        velocities = np.zeros((n_ends, n_frames), np.int64)
        starts = np.empty((n_ends, len(self._segments), 2), np.int64)
        values, left = np.empty(n_ends), np.zeros((n_ends, 5), np.int64)
        written = positions, velocities, starts, values, left

        def follow(of: slice, held: tuple[NDArray, NDArray[np.int64]], stop: int) -> None:
            viterbi_backtrack.trace_paths(*(array[of] for array in written), *held, self._scores,
                                          j, ends[of], stop, self._motion, self._layout)

        stop = self._held_from(j)
        for of, held in self._held_around(j, ends, stop == j > 0):
            follow(of, held, 0 if stop == j else stop)
        for i in np.flatnonzero(left[:, 0] > 0).tolist():
            follow(slice(i, i + 1), self._before(*left[i, :4].tolist()), 0)
        costs = (self._graph.turn_cost * left[:, 4]).tolist()
        return list(map(TracedPath, positions, velocities, values.tolist(), costs)), starts

    def _held_from(self, j: int) -> int:
        """Return the first of the segments up to j - 1 that are held without a gap, else j."""
        while j > 0 and self._whole[j - 1]:
            j -= 1
        return j

    def _held_around(self, j: int, ends: NDArray[np.int64], anew: bool,
                     ) -> Iterator[tuple[slice, tuple[NDArray, NDArray[np.int64]]]]:
        """Yield what may lead to ends (N, 2), and to which of them, computed anew or all held."""
        if not anew:
            yield slice(None), (self._tables, self._places)
            return
        for place, same in itertools.groupby(
                range(len(ends)), lambda i: place_of_cone(j, *ends[i].tolist())):
            if place != self._wide_place:
                self._fill('wide', j, None, *place[1:])
                self._wide_place = place
            first, *others = same
            yield slice(first, first + 1 + len(others)), self._filled('wide')

    def _before(self, j: int, y: int, x: int,
                velocity: int) -> tuple[NDArray, NDArray[np.int64]]:
        """Return what may lead to one state of segment j."""
        self._fill('narrow', j, velocity, y, x)
        return self._filled('narrow')

    def _filled(self, name: str) -> tuple[NDArray, NDArray[np.int64]]:
        return self._rooms[name].tables, self._rooms[name].places

    def _fill(self, name: str, j: int, velocity: int | None, y: int, x: int) -> None:
        """Fill the cone of some positions into a room."""
        if (j, velocity) not in self._cones:
            self._cones[j, velocity] = PathCone(self._segments[:j + 1], self._layout,
                                                self._end_costs, velocity)
        if name not in self._rooms:
            self._rooms[name] = ConeRoom(self._layout, len(self._segments))
        self._cones[j, velocity].fill(self._rooms[name], self._scores, y, x)
