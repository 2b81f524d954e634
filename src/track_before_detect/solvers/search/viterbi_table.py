"""Weights of the best paths to all states, kept up to date while the scores change.

The frames of one batch are searched several times, each time with a little more taken off them.
Only the states whose paths meet a change, and may pass the threshold, are then computed anew.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.search import (
    viterbi as path_search,
)
from track_before_detect.kernels.search import (
    viterbi_backtrack as path_trace,
)
from track_before_detect.kernels.search import (
    viterbi_update as path_update,
)
from track_before_detect.kernels.search.viterbi import ABSENT, BLOCKS, VECTOR
from track_before_detect.models.motion.state_graph import StateGraph

# A state costs this much more where some are computed than where all are: 2.1 to 2.4 times where
# a quarter to a half are, between which the choice is close (6 and 20 targets in 128 x 128 pixels,
# 50 in 256 x 256); 3 to 8 times where one in twenty or fewer are, which is little anyway.
COST_OF_UPDATE = 2.2
# In states.
CACHE_LINE = 16
NO_STATES = np.empty(0, np.float32)


class ViterbiTable:
    """The best path to every state of a graph.

    Parameters
    ----------
    graph : StateGraph
        The states.
    grid_shape : tuple of int
        (Y, X) of the position grid.
    n_threads : int
        Threads that share the rows. The compiled loops release the interpreter lock, so plain
        threads do, and numba's own threading layer, which aborts the process when two threads
        enter it, is never used.
    kind : array of int, shape (V,), optional
        Where what a position adds depends on the velocity: which of several scores is that of a
        velocity. Scores are then (C * T, Y, X), all frames of the first kind first, and every
        update computes all states.

    Attributes
    ----------
    best : array, shape (Y, X)
        Largest weight of the paths that start their last segment at a position.
    """

    def __init__(self, graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1,
                 kind: NDArray | None = None):
        self._graph = graph
        self._n_threads = n_threads
        self._layout = _layout(graph, grid_shape)
        self._n_kinds = 1 if kind is None else int(kind.max()) + 1
        kind = np.zeros(graph.n_velocities, np.int64) if kind is None else kind
        self._segments = [_segment(graph, j, self._layout, kind)
                          for j in range(graph.n_segments)]
        self._grid_shape = grid_shape
        # Memory is taken when the first search asks for it.
        self.best = np.empty((0, 0), np.float32)
        self._scores = NO_STATES
        self._largest = np.empty((0, 0), np.float32)
        self._tables: list[NDArray] = []
        # Which states are older than the scores, see the module viterbi_update.
        self._stale: list[NDArray] = []
        self._stale_last = np.empty(0, np.uint64)
        self._filled = False

    def fill(self, scores: NDArray) -> None:
        """Compute all states for scores of shape (T, Y, X)."""
        self._take_memory()
        self.over_rows(path_update.store_scores, self._scores, self._largest,
                       np.ascontiguousarray(scores), self._layout)
        self._fill()

    def _fill(self):
        n_y, n_v = self._layout.n_y, self._layout.n_v
        everything = np.full((n_y, n_v), ~np.uint64(0))
        everything >>= np.uint64(BLOCKS - self._n_blocks)
        self._compute([everything] * len(self._tables), everything[:, 0].copy())
        self._filled = True

    def update(self, scores: NDArray, level: float, rows: NDArray | None = None) -> float:
        """Bring the table up to date with new scores; return the largest weight.

        Where ``rows`` (T, Y) are false the scores are those of the call before. Afterwards
        ``best`` is exact wherever it is above ``level`` or the largest of all; below, it may be
        a bound. Both come out as if the table had been filled, bit for bit.
        """
        if not self._filled or self._n_kinds > 1:
            self.fill(scores)
            return float(self.best.max())
        if rows is None:
            rows = np.ones(scores.shape[:2], bool)
        rise = self._mark_changes(np.ascontiguousarray(scores), rows)
        self.over_rows(path_update.raise_stale, self.best, self._stale_last, np.float32(rise),
                       self._layout)
        n_y = self._layout.n_y
        known, bound = np.empty((2, n_y), np.float32)
        n_all = len(self._segments) * n_y * self._layout.n_v * self._n_blocks
        while True:
            wanted, wanted_last = self._wanted(level)
            n_wanted = path_update.count_blocks(wanted_last) * self._layout.n_v + sum(
                path_update.count_blocks(marks.ravel()) for marks in wanted)
            if COST_OF_UPDATE * n_wanted > n_all:
                self._fill()
                return float(self.best.max())
            self._compute(wanted, wanted_last)
            self.over_rows(path_update.largest_by_row, known, bound, self.best,
                           self._stale_last, self._layout)
            largest = float(known.max())
            if bound.max() <= largest:
                return largest
            level = min(level, largest)

    def forget(self) -> None:
        """Fill the whole table at the next search."""
        self._filled = False

    def peaks(self, above: float, radius: int, limit: int) -> NDArray[np.int64]:
        """Return y and x (N, 2) of separate maxima of ``best`` above a level, largest first.

        Parameters
        ----------
        above : float
            Only larger weights are picked.
        radius : int
            Rows and columns around one that is picked in which no other is.
        limit : int
            Most that are picked.
        """
        peaks = np.empty((limit, 2), np.int64)
        return peaks[:path_trace.pick_peaks(peaks, self.best, above, radius)]

    def trace(self, starts: NDArray) -> tuple[NDArray, NDArray]:
        """Return the best paths that start their last segment at y and x, ``starts`` (N, 2).

        All at once, for a call of a compiled loop costs more than following one path.

        Returns
        -------
        positions : array, shape (N, T, 2)
            x and y in grid steps.
        costs : array, shape (N,)
            Of their turns.
        """
        graph = self._graph
        positions = np.empty((len(starts), graph.n_frames, 2))
        y, x = np.array(starts, np.int64).T.copy()
        velocities, turns = np.zeros((2, len(starts)), np.int64)
        before = self._tables[-1] if self._tables else NO_STATES
        path_trace.best_velocities(velocities, before, self._scores, y, x, self._segments[-1],
                                   self._layout)
        for j in range(graph.n_segments - 1, -1, -1):
            first, last = graph.knots[j], graph.knots[j + 1]
            moves = graph.moves[first:last, velocities].swapaxes(0, 1)
            positions[:, first:last] = np.column_stack([x, y])[:, None] + moves
            if j > 0:
                path_trace.step_back(y, x, velocities, turns, self._tables[j - 1],
                                     self._segments[j], self._layout)
        return positions, graph.turn_cost * turns

    def over_rows(self, work: Callable[..., object], *arguments: Any) -> None:
        """Call work(*arguments, first row, last row) for all rows, shared out over threads."""
        n_y = self._layout.n_y
        if self._n_threads == 1 or n_y < 2 * self._n_threads:
            work(*arguments, 0, n_y)
            return
        bounds = np.linspace(0, n_y, self._n_threads + 1).astype(int)
        with ThreadPoolExecutor(self._n_threads) as pool:
            list(pool.map(partial(work, *arguments), bounds[:-1], bounds[1:]))

    @property
    def _n_blocks(self):
        return -(-self._layout.lanes // self._layout.block)

    def _take_memory(self):
        if len(self._scores):
            return
        layout, n_frames = self._layout, self._n_kinds * self._graph.n_frames
        margin = 2 * layout.pad + layout.lanes
        self._scores = np.full(n_frames * layout.n_y * layout.stride + margin, ABSENT)
        self._largest = np.empty((layout.n_y, n_frames), np.float32)
        size = layout.guard + layout.n_y * layout.n_v * layout.stride + margin
        self._tables = [_absent(size) for _ in self._segments[1:]]
        self._stale = [np.zeros((layout.n_y, layout.n_v), np.uint64) for _ in self._segments[1:]]
        self._stale_last = np.zeros(layout.n_y, np.uint64)
        self.best = np.empty(self._grid_shape, np.float32)

    def _compute(self, wanted, wanted_last):
        """Compute the wanted states, which are then no longer stale."""
        before = NO_STATES
        for table, segment, marks, stale in zip(self._tables, self._segments, wanted,
                                                self._stale, strict=False):
            self.over_rows(path_search.extend_paths, table, before, self._scores, segment,
                           self._layout, marks)
            stale &= ~marks
            before = table
        self.over_rows(path_search.finish_paths, self.best, before, self._scores,
                       self._segments[-1], self._layout, wanted_last)
        self._stale_last &= ~wanted_last

    def _mark_changes(self, scores, rows):
        """Keep new scores, mark the states that meet a change; return what a path may gain."""
        layout, n_frames = self._layout, len(scores)
        score_marks = np.empty((n_frames, layout.n_y), np.uint64)
        rise = np.empty((layout.n_y, n_frames), np.float32)
        self.over_rows(path_update.replace_scores, self._scores, self._scores.view(np.int32),
                       score_marks, rise, self._largest, scores,
                       scores.view(np.int32).ravel(), rows, layout)
        before = np.empty((0, layout.n_v), np.uint64)
        last = np.zeros((layout.n_y, layout.n_v), np.uint64)
        for j, marks in enumerate([*self._stale, last]):
            frames = slice(self._graph.knots[j], self._graph.knots[j + 1])
            self.over_rows(path_update.changed_states, marks, before, score_marks[frames],
                           self._graph.moves[frames], self._segments[j], layout)
            before = marks
        self.over_rows(path_update.any_velocity, self._stale_last, last)
        # A sum of n numbers is wrong by n roundings of their sizes, in the old and in the new.
        size = float(self._largest.max(axis=0).sum())
        rounding = 4 * (n_frames + len(self._segments)) * np.finfo(np.float32).eps * size
        return float(rise.max(axis=0).sum()) + rounding

    def _wanted(self, level):
        """Return the stale states before those of the last segment that may pass a level."""
        wanted = [np.empty_like(marks) for marks in self._stale]
        wanted_last = np.empty_like(self._stale_last)
        self.over_rows(path_update.wanted_last, wanted_last, self._stale_last, self.best, level,
                       self._layout)
        near = np.repeat(wanted_last[:, None], self._layout.n_v, axis=1)
        for j in range(len(wanted) - 1, -1, -1):
            self.over_rows(path_update.wanted_before, wanted[j], self._stale[j], near,
                           self._segments[j + 1].arrival, self._layout)
            if j > 0:
                self.over_rows(path_update.spread_turns, near, wanted[j], self._segments[j])
        return wanted, wanted_last


def table_bytes(graph: StateGraph, grid_shape: tuple[int, int]) -> int:
    """Return the memory that a table takes once it is filled."""
    layout = _layout(graph, grid_shape)
    rows = graph.n_frames + (graph.n_segments - 1) * layout.n_v
    return NO_STATES.itemsize * layout.n_y * (rows * layout.stride + layout.n_x)


def _layout(graph, grid_shape):
    n_y, n_x = grid_shape
    pad = int(max(np.abs(graph.moves).max(), np.abs(graph.end_moves).max()))
    stride = VECTOR * -(-(n_x + pad) // VECTOR)
    lanes = VECTOR * -(-n_x // VECTOR)
    return path_search.Layout(
        n_y, n_x, graph.n_velocities, stride, lanes, block=VECTOR * -(-lanes // (VECTOR * BLOCKS)),
        pad=pad, guard=VECTOR * -(-(stride + 2 * pad) // VECTOR))


def _absent(size):
    """Return so many absent states, the first at the start of a cache line.

    Writing rows that begin in the middle of one takes a quarter longer.
    """
    room = np.full(size + CACHE_LINE, ABSENT)
    first = -(room.ctypes.data // room.itemsize) % CACHE_LINE
    return room[first:first + size]


def _segment(graph, j, layout, kind):
    """Return what the compiled loops need to know of a segment."""
    first, last = graph.knots[j], graph.knots[j + 1]
    moves = np.asarray(graph.moves[first:last], np.int64)
    frames = (np.arange(first, last)[:, None] + graph.n_frames * kind) * layout.n_y
    offsets = (frames + moves[:, :, 1]) * layout.stride + moves[:, :, 0]
    reach = int(graph.reach)
    lengths = np.diff(graph.row_first)
    rows = np.repeat(np.arange(len(lengths)), lengths)
    columns = np.arange(layout.n_v) - graph.row_first[rows] + graph.row_x[rows]
    velocity_at = np.full((len(lengths) + 2 * reach, columns.max() + 1 + 2 * reach), layout.n_v)
    velocity_at[rows + reach, columns + reach] = np.arange(layout.n_v)
    return path_search.Segment(
        offsets=np.ascontiguousarray(offsets.T),
        first_y=np.maximum(0, -moves[:, :, 1].min(axis=0)),
        last_y=layout.n_y - np.maximum(0, moves[:, :, 1].max(axis=0)),
        arrival=np.asarray(graph.end_moves[j - 1] if j else np.empty((0, 2)), np.int64),
        slots=(rows + reach) * velocity_at.shape[1] + columns + reach,
        velocity_at=velocity_at.ravel(), columns=velocity_at.shape[1], reach=reach,
        cost=np.float32(graph.turn_cost))
