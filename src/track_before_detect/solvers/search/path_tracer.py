"""Follows paths back through a table of which not all states may be held."""

from collections.abc import Sequence
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

    def trace(self, j: int, y: int, x: int, starts: NDArray[np.int64]) -> TracedPath:
        """Return the best path that starts its last segment j at (y, x).

        ``starts`` (J, 2) receives x and y of its starts of segments, also of those that it would
        go on to.
        """
        n_frames, knots = self._graph.n_frames, self._motion.knots
        positions, velocities = np.full((n_frames, 2), np.nan), np.zeros(n_frames, np.int64)
        held, stop = (self._tables, self._places), self._held_from(j)
        if stop == j > 0:
            held, stop = self._around(j, y, x), 0
        known = self._motion, self._layout
        velocity, last, value = viterbi_backtrack.best_end(*held, self._scores, j, y, x, *known)
        starts[j] = x, y
        for later in range(j + 1, len(starts)):
            starts[later] = starts[later - 1] + self._motion.end_moves[later - 1, velocity]
        written = positions, velocities, starts
        left, y, x, velocity, turns = viterbi_backtrack.follow_back(
            *written, *held, self._scores, j, y, x, velocity, last, stop, *known)
        if left > 0:
            held = self._before(left, y, x, velocity)
            *_, more = viterbi_backtrack.follow_back(
                *written, *held, self._scores, left, y, x, velocity, knots[left + 1] - 1, 0,
                *known)
            turns += more
        return TracedPath(positions, velocities, value, self._graph.turn_cost * turns)

    def _held_from(self, j: int) -> int:
        """Return the first of the segments up to j - 1 that are held without a gap, else j."""
        while j > 0 and self._whole[j - 1]:
            j -= 1
        return j

    def _around(self, j: int, y: int, x: int) -> tuple[NDArray, NDArray[np.int64]]:
        """Return what may lead to the start of segment j at (y, x) and beside it."""
        place = place_of_cone(j, y, x)
        if place != self._wide_place:
            self._fill('wide', j, None, *place[1:])
            self._wide_place = place
        return self._rooms['wide'].tables, self._rooms['wide'].places

    def _before(self, j: int, y: int, x: int,
                velocity: int) -> tuple[NDArray, NDArray[np.int64]]:
        """Return what may lead to one state of segment j."""
        self._fill('narrow', j, velocity, y, x)
        return self._rooms['narrow'].tables, self._rooms['narrow'].places

    def _fill(self, name: str, j: int, velocity: int | None, y: int, x: int) -> None:
        """Fill the cone of some positions into a room."""
        if (j, velocity) not in self._cones:
            self._cones[j, velocity] = PathCone(self._segments[:j + 1], self._layout,
                                                self._end_costs, velocity)
        if name not in self._rooms:
            self._rooms[name] = ConeRoom(self._layout, len(self._segments))
        self._cones[j, velocity].fill(self._rooms[name], self._scores, y, x)
