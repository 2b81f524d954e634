"""Weights of the best paths to all states, kept up to date while the scores change.

The frames of one batch are searched several times, each time with a little more taken off them.
Only the states whose paths meet a change, and may pass the threshold, are then computed anew.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT, absent_rows
from track_before_detect.kernels.search import viterbi, viterbi_backtrack, viterbi_update
from track_before_detect.kernels.search.viterbi import BLOCKS, VECTOR
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence

# A state costs this much more where some are computed than where all are
# (docs/constants/search.md).
COST_OF_UPDATE = 2.2
NO_STATES = np.empty(0, np.float32)
NO_ENDS = np.empty((0, 0), np.float32)


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


class RowThreads:
    """Calls compiled loops for all rows of a grid, shared out over threads.

    The compiled loops release the interpreter lock, so plain threads do, and numba's own threading
    layer, which aborts the process when two threads enter it, is never used.

    Parameters
    ----------
    n_rows : int
        Rows of the grid.
    n_threads : int
        Threads that share them.
    """

    def __init__(self, n_rows: int, n_threads: int):
        self._n_rows = n_rows
        self._n_threads = n_threads

    def __call__(self, work: Callable[..., object], *arguments: Any) -> None:
        """Call work(*arguments, first row, last row) until all rows are done."""
        if self._n_threads == 1 or self._n_rows < 2 * self._n_threads:
            work(*arguments, 0, self._n_rows)
            return
        bounds = np.linspace(0, self._n_rows, self._n_threads + 1).astype(int)
        with ThreadPoolExecutor(self._n_threads) as pool:
            list(pool.map(partial(work, *arguments), bounds[:-1], bounds[1:]))


class ViterbiTable:
    """The best path to every state of a graph.

    Parameters
    ----------
    graph : StateGraph
        The states.
    grid_shape : tuple of int
        (Y, X) of the position grid.
    n_threads : int
        Threads that share the rows.
    kinds : array of int, shape (V,), optional
        Where what a position adds depends on the velocity: which of several scores is that of a
        velocity. Scores are then (C * T, Y, X), all frames of the first kind first, and every
        update computes all states.
    presence : Presence, optional
        Cost of entering and leaving, where targets may do so during the batch; what a frame costs
        is told with the scores.

    Attributes
    ----------
    best : array, shape (E, Y, X)
        Largest weight of the paths that end in each of the last E segments, by the position at its
        start: in the last segment alone, or in any where targets may leave.
    """

    def __init__(self, graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1,
                 kinds: NDArray | None = None, presence: Presence | None = None):
        self._graph = graph
        self._layout = _layout(graph, grid_shape)
        self._over_rows = RowThreads(grid_shape[0], n_threads)
        kinds = np.zeros(graph.n_velocities, np.int64) if kinds is None else kinds
        self._n_kinds = int(kinds.max()) + 1
        self._motion = _motion(graph, kinds, presence)
        self._segments = [_segment(graph, j, self._layout, self._motion)
                          for j in range(graph.n_segments)]
        self._end_costs = [_end_costs(presence, j == graph.n_segments - 1)
                           for j in range(graph.n_segments)]
        self._n_ends = graph.n_segments if presence else 1
        self._grid_shape = grid_shape
        # Memory is taken when the first search asks for it.
        self.best = np.empty((0, 0, 0), np.float32)
        self._scores = NO_STATES
        self._largest = np.empty((0, 0), np.float32)
        self._tables = np.empty((0, 0), np.float32)
        # Which states and which best ends are older than the scores, see ``viterbi_update``.
        self._stale = np.empty((0, 0, 0), np.uint64)
        self._stale_ends = np.empty((0, 0), np.uint64)
        self._filled = False

    def fill(self, scores: NDArray, per_frame: float = 0.0) -> float:
        """Compute all states for scores of shape (T, Y, X); return the largest weight.

        Every frame of a path costs ``per_frame``.
        """
        self._take_memory()
        self._over_rows(viterbi_update.store_scores, self._scores, self._largest,
                        np.ascontiguousarray(scores), np.float32(per_frame), self._layout)
        return self._fill()

    def _fill(self) -> float:
        everything = ~np.uint64(0) >> np.uint64(BLOCKS - self._n_blocks)
        self._compute(np.full_like(self._stale, everything),
                      np.full_like(self._stale_ends, everything))
        self._stale.fill(0)
        self._stale_ends.fill(0)
        self._filled = True
        return float(self.best.max())

    def update(self, scores: NDArray, level: float, rows: NDArray | None = None,
               per_frame: float = 0.0) -> float:
        """Bring the table up to date with new scores; return the largest weight.

        Where ``rows`` (T, Y) are false the scores are those of the call before. Afterwards
        ``best`` is exact wherever it is above ``level`` or the largest of all; below, it may be
        a bound. Both come out as if the table had been filled, bit for bit.
        """
        if not self._filled or self._n_kinds > 1:
            return self.fill(scores, per_frame)
        if rows is None:
            rows = np.ones(scores.shape[:2], bool)
        rise = self._mark_changes(np.ascontiguousarray(scores), rows, per_frame)
        for best, stale in zip(self.best, self._stale_ends, strict=True):
            self._over_rows(viterbi_update.raise_stale, best, stale, np.float32(rise),
                            self._layout)
        known, bound = np.empty((2, self._n_ends, self._layout.n_y), np.float32)
        n_all = self._stale.size * self._n_blocks
        while True:
            wanted, wanted_ends = self._wanted(level)
            if COST_OF_UPDATE * viterbi_update.count_blocks(wanted.ravel()) > n_all:
                return self._fill()
            self._compute(wanted, wanted_ends)
            self._stale &= ~wanted
            self._stale_ends &= ~wanted_ends
            for of_end in zip(known, bound, self.best, self._stale_ends, strict=True):
                self._over_rows(viterbi_update.largest_by_row, *of_end, self._layout)
            largest = float(known.max())
            if bound.max() <= largest:
                return largest
            level = min(level, largest)

    def forget(self) -> None:
        """Fill the whole table at the next search."""
        self._filled = False

    def best_paths(self, above: float, radius: int, limit: int) -> list[TracedPath]:
        """Return the paths of the largest weights above a level, the largest first, and apart.

        Parameters
        ----------
        above : float
            Only paths of larger weights are returned.
        radius : int
            Rows and columns around the start of the last segment of a path that is found in which
            no other starts it.
        limit : int
            Most that are returned.
        """
        positions = np.empty((limit, self._graph.n_frames, 2))
        velocities = np.zeros((limit, self._graph.n_frames), np.int64)
        values, turns = np.empty(limit), np.empty(limit, np.int64)
        n_found = viterbi_backtrack.best_paths(
            positions, velocities, values, turns, self.best, self._tables, self._scores,
            self._motion, self._layout, max(above, float(ABSENT)), radius)
        return [TracedPath(positions[i], velocities[i], float(values[i]),
                           float(self._graph.turn_cost * turns[i])) for i in range(n_found)]

    @property
    def _n_blocks(self) -> int:
        return -(-self._layout.lanes // self._layout.block)

    def _take_memory(self) -> None:
        if len(self._scores):
            return
        layout, n_segments = self._layout, self._graph.n_segments
        n_frames = self._n_kinds * self._graph.n_frames
        margin = 2 * layout.pad + layout.lanes
        self._scores = np.full(n_frames * layout.n_y * layout.stride + margin, ABSENT)
        self._largest = np.empty((layout.n_y, n_frames), np.float32)
        self._tables = absent_rows(
            n_segments - 1, layout.guard + layout.n_y * layout.n_v * layout.stride + margin)
        self._stale = np.zeros((n_segments, layout.n_y, layout.n_v), np.uint64)
        self._stale_ends = np.zeros((self._n_ends, layout.n_y), np.uint64)
        self.best = np.empty((self._n_ends, *self._grid_shape), np.float32)

    def _end_of(self, j: int) -> int:
        """Return where ``best`` holds the paths that end in segment j, below zero if nowhere."""
        return j - self._graph.n_segments + self._n_ends

    def _compute(self, wanted: NDArray, wanted_ends: NDArray) -> None:
        """Compute the wanted states (J, Y, V) and ends (E, Y).

        Where an end is wanted, the states of all velocities have to be.
        """
        before = NO_STATES
        for j, segment in enumerate(self._segments):
            value = self._tables[j] if j < len(self._tables) else NO_STATES
            end = self._end_of(j)
            best, finished = ((self.best[end], wanted_ends[end]) if end >= 0
                              else (NO_ENDS, wanted_ends[0]))
            self._over_rows(viterbi.extend_paths, value, best, before, self._scores, segment,
                            self._layout, self._end_costs[j], wanted[j], finished)
            before = value

    def _mark_changes(self, scores: NDArray, rows: NDArray, per_frame: float) -> float:
        """Keep new scores, mark the states that meet a change; return what a path may gain."""
        layout, n_frames = self._layout, len(scores)
        score_marks = np.empty((n_frames, layout.n_y), np.uint64)
        rise = np.empty((layout.n_y, n_frames), np.float32)
        self._over_rows(viterbi_update.replace_scores, self._scores, score_marks, rise,
                        self._largest, scores, np.float32(per_frame), rows, layout)
        before = np.empty((0, layout.n_v), np.uint64)
        for j, stale in enumerate(self._stale):
            frames = slice(self._graph.knots[j], self._graph.knots[j + 1])
            self._over_rows(viterbi_update.changed_states, stale, before, score_marks[frames],
                            self._graph.moves[frames], self._segments[j], layout)
            before = stale
            if self._end_of(j) >= 0:
                self._stale_ends[self._end_of(j)] |= np.bitwise_or.reduce(stale, axis=1)
        # A sum of n numbers is wrong by n roundings of their sizes, in the old and in the new.
        size = float(self._largest.max(axis=0).sum())
        if self._end_costs[0] is not None:
            size += float(self._motion.entry + self._motion.leaving)
        rounding = 4 * (n_frames + len(self._segments)) * float(np.finfo(np.float32).eps) * size
        return float(rise.max(axis=0).sum()) + rounding

    def _wanted(self, level: float) -> tuple[NDArray, NDArray]:
        """Return the states and ends that are needed to know those that may pass a level."""
        wanted, ends = np.zeros_like(self._stale), np.zeros_like(self._stale_ends)
        near = np.empty_like(self._stale[0])
        for j in range(len(self._segments) - 1, -1, -1):
            if j + 1 < len(self._segments):
                self._over_rows(viterbi_update.spread_turns, near, wanted[j + 1],
                                self._segments[j + 1])
                self._over_rows(viterbi_update.wanted_before, wanted[j], self._stale[j], near,
                                self._segments[j + 1].arrival, self._layout)
            end = self._end_of(j)
            if end >= 0:
                self._over_rows(viterbi_update.wanted_ends, ends[end], self._stale_ends[end],
                                self.best[end], level, self._layout)
                wanted[j] |= ends[end][:, None]
        return wanted, ends


def table_bytes(graph: StateGraph, grid_shape: tuple[int, int],
                presence: Presence | None = None) -> int:
    """Return the memory that a table takes once it is filled."""
    layout = _layout(graph, grid_shape)
    rows = graph.n_frames + (graph.n_segments - 1) * layout.n_v
    n_ends = graph.n_segments if presence else 1
    return NO_STATES.itemsize * layout.n_y * (rows * layout.stride + n_ends * layout.n_x)


def _layout(graph: StateGraph, grid_shape: tuple[int, int]) -> viterbi.Layout:
    n_y, n_x = grid_shape
    pad = int(max(np.abs(graph.moves).max(), np.abs(graph.end_moves).max()))
    stride = VECTOR * -(-(n_x + pad) // VECTOR)
    lanes = VECTOR * -(-n_x // VECTOR)
    return viterbi.Layout(
        n_y, n_x, graph.n_velocities, stride, lanes, block=VECTOR * -(-lanes // (VECTOR * BLOCKS)),
        pad=pad, guard=VECTOR * -(-(stride + 2 * pad) // VECTOR))


def _motion(graph: StateGraph, kinds: NDArray, presence: Presence | None,
            ) -> viterbi_backtrack.Motion:
    """Return what the compiled loops need to know of a graph."""
    reach = int(graph.reach)
    columns, rows = graph.grid.T
    velocity_at = np.full((rows.max() + 1 + 2 * reach, columns.max() + 1 + 2 * reach),
                          graph.n_velocities)
    velocity_at[rows + reach, columns + reach] = np.arange(graph.n_velocities)
    entry, leaving = (presence.entry, presence.leaving) if presence else (-ABSENT, -ABSENT)
    return viterbi_backtrack.Motion(
        np.asarray(graph.knots, np.int64), np.asarray(graph.moves, np.int64),
        np.asarray(graph.end_moves, np.int64), np.asarray(kinds, np.int64),
        viterbi.Turns((rows + reach) * velocity_at.shape[1] + columns + reach,
                      velocity_at.ravel(), velocity_at.shape[1], reach,
                      np.float32(graph.turn_cost)),
        np.float32(entry), np.float32(leaving))


def _segment(graph: StateGraph, j: int, layout: viterbi.Layout,
             motion: viterbi_backtrack.Motion) -> viterbi.Segment:
    """Return what the compiled loops need to know of a segment."""
    first, last = motion.knots[j], motion.knots[j + 1]
    x, y = motion.moves[first:last].transpose(2, 1, 0)
    frames = (np.arange(first, last) + graph.n_frames * motion.kinds[:, None]) * layout.n_y
    return viterbi.Segment(
        offsets=np.ascontiguousarray((frames + y) * layout.stride + x),
        rows=np.ascontiguousarray(y), first_y=np.maximum(0, -y.min(axis=1)),
        last_y=layout.n_y - np.maximum(0, y.max(axis=1)),
        arrival=motion.end_moves[j - 1] if j else np.empty((0, 2), np.int64),
        turns=motion.turns)


def _end_costs(presence: Presence | None, last: bool) -> viterbi.EndCosts | None:
    """Return the costs of beginning and ending within a segment, None where that may not be."""
    if presence is None:
        return None
    leaving = np.float32(presence.leaving)
    return viterbi.EndCosts(np.float32(presence.entry), leaving,
                            np.float32(0) if last else leaving)
