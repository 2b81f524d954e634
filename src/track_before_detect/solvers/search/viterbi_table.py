"""Weights of the best paths to all states, kept up to date while the scores change.

The frames of one batch are searched several times, each time with a little more taken off them.
Only the states whose paths meet a change, and may pass the threshold, are then computed anew.
"""

from collections.abc import Callable
from functools import partial
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT, absent_rows
from track_before_detect.kernels.search import viterbi, viterbi_backtrack, viterbi_update
from track_before_detect.kernels.search.viterbi import BLOCKS
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.parallel import share_out
from track_before_detect.solvers.search.compiled_graph import (
    end_costs_of,
    layout_of,
    motion_of,
    placed,
    segment_of,
)
from track_before_detect.solvers.search.held_rows import HeldRows
from track_before_detect.solvers.search.path_cone import NO_ENDS, NO_STATES, place_of_cone
from track_before_detect.solvers.search.path_tracer import PathTracer, TracedPath

# A state costs this much more where some are computed than where all are
# (docs/constants/search.md).
COST_OF_UPDATE = 2.2


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
        self.between(0, self._n_rows, work, *arguments)

    def between(self, first: int, last: int, work: Callable[..., object],
                *arguments: Any) -> None:
        """Do so for the rows from ``first`` to ``last``."""
        if self._n_threads == 1 or last - first < 2 * self._n_threads:
            work(*arguments, first, last)
            return
        bounds = np.linspace(first, last, 2 * self._n_threads + 1).astype(int)
        share_out(partial(work, *arguments), zip(bounds[:-1], bounds[1:], strict=True),
                  self._n_threads)


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
    most_bytes : float
        Memory that it may take, see :func:`table_bytes`. Where that is less than for all states,
        those of the first segments are computed whenever they are needed, and take memory only
        while they are; what comes out is the same.

    Attributes
    ----------
    best : array, shape (E, Y, X)
        Largest weight of the paths that end in each of the last E segments, by the position at its
        start: in the last segment alone, or in any where targets may leave.
    """

    def __init__(self, graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1,
                 kinds: NDArray | None = None, presence: Presence | None = None,
                 most_bytes: float = math.inf):
        self._graph = graph
        self._layout = layout_of(graph, grid_shape)
        self._over_rows = RowThreads(grid_shape[0], n_threads)
        kinds = np.zeros(graph.n_velocities, np.int64) if kinds is None else kinds
        self._n_kinds = int(kinds.max()) + 1
        self._motion = motion_of(graph, kinds, presence)
        self._segments = [segment_of(graph, j, self._layout, self._motion)
                          for j in range(graph.n_segments)]
        self._end_costs = [end_costs_of(presence, j == graph.n_segments - 1)
                           for j in range(graph.n_segments)]
        self._n_ends = graph.n_segments if presence else 1
        self._rows = HeldRows(graph, self._layout, most_bytes - _other_bytes(
            graph, self._layout, presence, self._n_kinds))
        self._tracer = PathTracer(graph, self._layout, self._motion, self._segments,
                                  self._end_costs, self._rows.whole)
        self._grid_shape = grid_shape
        # Memory is taken when the first search asks for it.
        self.best = np.empty((0, 0, 0), np.float32)
        self._scores = NO_STATES
        self._largest = np.empty((0, 0), np.float32)
        self._tables = NO_STATES
        self._places = np.empty((0, 0, 0), np.int64)
        # Which states and which best ends are older than the scores, see ``viterbi_update``.
        self._stale = np.empty((0, 0, 0), np.uint64)
        self._stale_ends = np.empty((0, 0), np.uint64)
        self._filled = False
        # Paths by their ends of which nothing has changed since they were traced.
        self._traced: dict[tuple[int, int, int], TracedPath] = {}

    def fill(self, scores: NDArray, per_frame: float = 0.0) -> float:
        """Compute all states for scores of shape (T, Y, X); return the largest weight.

        Every frame of a path costs ``per_frame``.
        """
        self._take_memory()
        self._store(scores, per_frame)
        return self._fill()

    def _store(self, scores: NDArray, per_frame: float) -> None:
        self._over_rows(viterbi_update.store_scores, self._scores, self._largest,
                        np.ascontiguousarray(scores), np.float32(per_frame), self._layout)

    def _fill(self) -> float:
        self._compute(np.full_like(self._stale, self._everything),
                      np.full_like(self._stale_ends, self._everything))
        self._stale.fill(0)
        self._stale_ends.fill(0)
        self._traced.clear()
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
        self._traced = {peak: path for peak, path in self._traced.items()
                        if not self._is_stale(*peak)}
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
        best = self.best.copy()
        # The largest of each row is kept, so that a peak costs the rows around it and not all.
        at = np.argmax(best, axis=2)
        # Rounding leaves much of what is absent.
        above = max(above, 0.5 * float(ABSENT))
        self._tracer.begin(self._scores, self._tables, self._places)
        if self._n_ends > 1:
            return self._best_paths_in_turn(best, at, above, radius, limit)
        # Where they end is known, so they may be traced together.
        places = np.empty((limit, 3), np.int64)
        n_peaks = viterbi_backtrack.pick_peaks(places, best, at, above, radius)
        peaks = list(map(tuple, places[:n_peaks].tolist()))
        new = sorted((peak for peak in peaks if peak not in self._traced),
                     key=lambda peak: place_of_cone(*peak))
        if new:
            paths, _ = self._tracer.trace(len(self._segments) - 1, np.array(new)[:, 1:])
            self._traced.update(zip(new, paths, strict=True))
        if self._end_costs[0] is not None:
            return [self._traced[peak] for peak in peaks]
        return [self._traced[peak]._replace(value=float(self.best[peak])) for peak in peaks]

    def _best_paths_in_turn(self, best: NDArray, at: NDArray[np.int64], above: float, radius: int,
                            limit: int) -> list[TracedPath]:
        """Trace one path after the other: where it may end leaves room for others or not."""
        found: list[TracedPath] = []
        first, peak = self._graph.n_segments - self._n_ends, np.empty((1, 3), np.int64)
        while len(found) < limit and viterbi_backtrack.pick_peaks(peak, best, at, above, radius):
            [path], [starts] = self._tracer.trace(first + int(peak[0, 0]), peak[:, 1:])
            found.append(path)
            viterbi_backtrack.leave_out(best, at, starts[first:], radius)
        return found

    def _is_stale(self, end: int, y: int, x: int) -> bool:
        """Return whether what a path that ends there meets may be older than the scores."""
        return bool(self._stale_ends[end, y] >> np.uint64(x // self._layout.block) & np.uint64(1))

    @property
    def _n_blocks(self) -> int:
        return -(-self._layout.lanes // self._layout.block)

    @property
    def _everything(self) -> np.uint64:
        """Return the mark of all blocks of a row."""
        return ~np.uint64(0) >> np.uint64(BLOCKS - self._n_blocks)

    def _take_memory(self) -> None:
        if len(self._scores):
            return
        layout = self._layout
        self._take_memory_of_scores()
        self._place(self._rows.places(), self._rows.size)
        self._stale = np.zeros((self._graph.n_segments, layout.n_y, layout.n_v), np.uint64)
        self._stale_ends = np.zeros((self._n_ends, layout.n_y), np.uint64)

    def _take_memory_of_scores(self) -> None:
        layout, n_frames = self._layout, self._n_kinds * self._graph.n_frames
        self._scores = np.full(n_frames * layout.n_y * layout.stride + margin_of(layout), ABSENT)
        self._largest = np.empty((layout.n_y, n_frames), np.float32)
        self.best = np.empty((self._n_ends, *self._grid_shape), np.float32)

    def _place(self, places: NDArray[np.int64], size: int) -> None:
        """Make a table of so many numbers, its states in their places (J - 1, Y, V)."""
        self._tables = absent_rows(1, size + margin_of(self._layout))[0]
        self._places = places
        self._segments = [placed(segment, j, places) for j, segment in enumerate(self._segments)]

    def _end_of(self, j: int) -> int:
        """Return where ``best`` holds the paths that end in segment j, below zero if nowhere."""
        return j - self._graph.n_segments + self._n_ends

    def _compute(self, wanted: NDArray, wanted_ends: NDArray) -> None:
        """Compute the wanted states (J, Y, V) and ends (E, Y).

        Where an end is wanted, the states of all velocities have to be.
        """
        for j, first, last in self._rows.turns():
            end = self._end_of(j)
            best, finished = ((self.best[end], wanted_ends[end]) if end >= 0
                              else (NO_ENDS, wanted_ends[0]))
            self._over_rows.between(
                first, last, viterbi.extend_paths,
                self._tables if j < len(self._places) else NO_STATES, best,
                self._tables if j else NO_STATES, self._scores, self._segments[j], self._layout,
                self._end_costs[j], wanted[j], finished)

    def _mark_changes(self, scores: NDArray, rows: NDArray, per_frame: float) -> float:
        """Keep new scores, mark the states that meet a change; return what a path may gain."""
        layout, n_frames = self._layout, len(scores)
        score_marks = np.empty((n_frames, layout.n_y), np.uint64)
        rise = np.empty((layout.n_y, n_frames), np.float32)
        self._over_rows(viterbi_update.replace_scores, self._scores, score_marks, rise,
                        self._largest, scores, np.float32(per_frame),
                        np.ascontiguousarray(rows), layout)
        before = np.empty((0, layout.n_v), np.uint64)
        # Of what is not held, only what changes now matters.
        self._stale[:-1][~self._rows.whole] = 0
        for j, stale in enumerate(self._stale):
            frames = slice(self._graph.knots[j], self._graph.knots[j + 1])
            self._over_rows(viterbi_update.changed_states, stale, before, score_marks[frames],
                            self._graph.moves[frames], self._segments[j], layout)
            before = stale
            if self._end_of(j) >= 0:
                self._stale_ends[self._end_of(j)] |= np.bitwise_or.reduce(stale, axis=1)
        return float(rise.max(axis=0).sum()) + self._rounding()

    def _rounding(self) -> float:
        """Return by how much two sums along a path may differ by their order, or old and new."""
        # A sum of n numbers is wrong by n roundings of their sizes.
        size = float(self._largest.max(axis=0).sum())
        if self._end_costs[0] is not None:
            size += float(self._motion.entry + self._motion.leaving)
        n_numbers = self._largest.shape[1] + len(self._segments)
        return 4 * n_numbers * float(np.finfo(np.float32).eps) * size

    def _wanted(self, level: float) -> tuple[NDArray, NDArray]:
        """Return the states and ends that are needed to know those that may pass a level."""
        wanted, ends = np.zeros_like(self._stale), np.zeros_like(self._stale_ends)
        near = np.empty_like(self._stale[0])
        not_held = np.full_like(near, self._everything)
        for j in range(len(self._segments) - 1, -1, -1):
            if j + 1 < len(self._segments):
                self._over_rows(viterbi_update.spread_turns, near, wanted[j + 1],
                                self._segments[j + 1])
                self._over_rows(viterbi_update.wanted_before, wanted[j],
                                self._stale[j] if self._rows.whole[j] else not_held, near,
                                self._segments[j + 1].arrival, self._layout)
            end = self._end_of(j)
            if end >= 0:
                self._over_rows(viterbi_update.wanted_ends, ends[end], self._stale_ends[end],
                                self.best[end], level, self._layout)
                wanted[j] |= ends[end][:, None]
        return wanted, ends


def margin_of(layout: viterbi.Layout) -> int:
    """Return the numbers that are read beyond the last row of scores or states."""
    return 2 * layout.pad + layout.lanes


def table_bytes(graph: StateGraph, grid_shape: tuple[int, int],
                presence: Presence | None = None, n_kinds: int = 1,
                most_bytes: float = math.inf) -> int:
    """Return the memory that a table takes once it is filled, which is more than it may at times.

    Parameters
    ----------
    graph, grid_shape, presence, most_bytes
        As of :class:`ViterbiTable`.
    n_kinds : int
        How many scores there are.
    """
    layout = layout_of(graph, grid_shape)
    others = _other_bytes(graph, layout, presence, n_kinds)
    return others + HeldRows(graph, layout, most_bytes - others).n_bytes


def _other_bytes(graph: StateGraph, layout: viterbi.Layout, presence: Presence | None,
                 n_kinds: int) -> int:
    """Return the memory that a table takes for scores and for the best ends."""
    n_ends = graph.n_segments if presence else 1
    return NO_STATES.itemsize * layout.n_y * (
        n_kinds * graph.n_frames * layout.stride + n_ends * layout.n_x)
