"""Weights of the best paths to all states, kept up to date while the scores change.

The frames of one batch are searched several times, each time with a little more taken off them.
Only the states whose paths meet a change are then computed anew; the table is the same, bit for
bit, as if it had been filled from the start.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import path_search, path_update
from track_before_detect.models.state_graph import StateGraph

# A state costs this much more where few are computed than where all are.
COST_OF_UPDATE = 2.5
# Positions per block of marks, at least: what the compiled loops take at a time.
LEAST_BLOCK = 32


class PathTable:
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

    Attributes
    ----------
    values : array, shape (J, Y, V, X)
        Weight of the best path up to and including each segment.
    best : array, shape (Y, X)
        Largest weight over all velocities of the last segment.
    """

    def __init__(self, graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1):
        self._graph = graph
        self._n_threads = n_threads
        n_y, n_x = grid_shape
        # Memory is taken when the first search asks for it.
        self._shape = (graph.n_segments, n_y, graph.n_velocities, n_x)
        self.values = np.empty((0, 0, 0, 0), np.float32)
        self.best = np.empty((0, 0), np.float32)
        self._scores: NDArray | None = None
        most = path_update.BLOCKS * LEAST_BLOCK
        self._block = LEAST_BLOCK * -(-n_x // most)
        self._n_blocks = math.prod(self._shape[:3]) * -(-n_x // self._block)
        # Which states are older than the scores, see the module path_update.
        self._stale = np.empty((0, 0, 0), np.uint64)

    def fill(self, scores: NDArray) -> None:
        """Compute all states for scores of shape (T, Y, X)."""
        if not len(self.values):
            self.values = np.empty(self._shape, np.float32)
            self.best = np.empty((self._shape[1], self._shape[3]), np.float32)
            self._stale = np.empty(self._shape[:3], np.uint64)
        for segment in range(self._graph.n_segments):
            self.over_rows(path_search.forward_segment, *self._segment(scores, segment))
        self.over_rows(path_search.best_by_position, self.values[-1], self.best)
        self._scores = scores
        self._stale[:] = 0

    def update(self, scores: NDArray, level: float) -> float:
        """Bring the table up to date with new scores, which it keeps; return the largest weight.

        Afterwards ``best`` is exact wherever it is above ``level`` or the largest of all; below,
        it may be a bound. The values before the best of an exact entry are exact, too.
        """
        if self._scores is None:
            self.fill(scores)
            return float(self.best.max())
        rise = self._mark_changes(scores, self._scores)
        self._scores = scores
        self.over_rows(path_update.raise_stale, self.best, self._stale[-1], np.float32(rise),
                       self._block)
        while True:
            wanted = self._wanted(level)
            if COST_OF_UPDATE * sum(map(path_update.count_blocks, wanted)) > self._n_blocks:
                self.fill(scores)
                return float(self.best.max())
            self._compute(scores, wanted)
            known, bound = path_update.largest_known(self.best, self._stale[-1], self._block)
            if bound <= known:
                return float(known)
            level = min(level, float(known))

    def forget(self) -> None:
        """Fill the whole table at the next search."""
        self._scores = None

    def over_rows(self, work: Callable[..., object], *arguments: Any) -> None:
        """Call work(*arguments, first row, last row) for all rows, shared out over threads."""
        n_y = self._shape[1]
        if self._n_threads == 1 or n_y < 2 * self._n_threads:
            work(*arguments, 0, n_y)
            return
        bounds = np.linspace(0, n_y, self._n_threads + 1).astype(int)
        with ThreadPoolExecutor(self._n_threads) as pool:
            list(pool.map(partial(work, *arguments), bounds[:-1], bounds[1:]))

    def _segment(self, scores, segment):
        """Return what the kernels need to know of a segment."""
        graph, values = self._graph, self.values
        before = values[segment - 1] if segment else values[0, :0]
        return (values[segment], before, scores, graph.moves, graph.end_moves[max(segment - 1, 0)],
                graph.knots[segment], graph.knots[segment + 1], graph.row_first, graph.row_x,
                graph.reach, np.float32(graph.turn_cost))

    def _mark_changes(self, new, old):
        """Add to the stale states those that meet a change; return by how much a path may gain."""
        graph, block = self._graph, self._block
        n_segments, n_y, _, n_x = self._shape
        score_marks = np.empty((len(new), n_y), np.uint64)
        rise = np.empty((n_y, len(new)), np.float32)
        self.over_rows(path_update.changed_scores, score_marks, rise, new, old,
                       new.view(np.int32), old.view(np.int32), block)
        for segment in range(n_segments):
            before = self._stale[segment - 1] if segment else self._stale[0, :0]
            self.over_rows(path_update.changed_states, self._stale[segment], before, score_marks,
                           graph.moves, graph.end_moves[max(segment - 1, 0)],
                           graph.knots[segment], graph.knots[segment + 1], graph.row_first,
                           graph.row_x, graph.reach, block, n_x)
        # Sums of n numbers are wrong by n roundings of their largest, in the old and in the new.
        size = sum(float(max(abs(frame.min()), abs(frame.max()))) for frame in old)
        rounding = 4 * (len(new) + n_segments) * np.finfo(np.float32).eps * size
        return float(rise.max(axis=0).sum()) + rounding

    def _wanted(self, level):
        """Return the stale states before those of the last segment that may pass a level."""
        graph, stale = self._graph, self._stale
        wanted = np.empty_like(stale)
        near = np.empty_like(stale[0])
        self.over_rows(path_update.wanted_last, wanted[-1], stale[-1], self.best, level,
                       self._block)
        for segment in range(len(stale) - 1, 0, -1):
            self.over_rows(path_update.spread_turns, near, wanted[segment], graph.row_first,
                           graph.row_x, graph.reach)
            self.over_rows(path_update.wanted_before, wanted[segment - 1], stale[segment - 1],
                           near, graph.end_moves[segment - 1], self._block)
        return wanted

    def _compute(self, scores, wanted):
        """Compute the wanted states, which are then no longer stale."""
        for segment in range(self._graph.n_segments):
            self.over_rows(path_update.update_segment, *self._segment(scores, segment),
                           wanted[segment], self._block)
        self.over_rows(path_update.update_best, self.best, self.values[-1], wanted[-1],
                       self._block)
        self._stale &= ~wanted
