"""Weights of the best paths, found among cells of positions first.

A table of cells of two by two positions takes a quarter of the work and of the memory, and bounds
all paths (module ``kernels.search.cells``). Only the states that may be on a path above the level
that is asked for are computed among positions: few of many where targets may be fast.
"""

from collections.abc import Iterator
from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT, absent_rows
from track_before_detect.kernels.search import cells, viterbi
from track_before_detect.models.motion.state_graph import build_state_graph, StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.compiled_graph import (
    layout_of,
    motion_of,
    placed,
    segment_of,
)
from track_before_detect.solvers.search.held_rows import HeldRows
from track_before_detect.solvers.search.path_cone import NO_ENDS, NO_STATES
from track_before_detect.solvers.search.path_tracer import TracedPath
from track_before_detect.solvers.search.viterbi_table import (
    margin_of,
    RowThreads,
    table_bytes,
    ViterbiTable,
)

# States and velocities from which on searching cells first may be quicker, and what it takes in
# units of the time that all states do: the pass over cells, and a state that is marked; then what
# a search of all states takes of it when a part of the scores has changed
# (docs/constants/search.md).
LEAST_STATES, LEAST_VELOCITIES = 2e7, 100
COST_OF_CELLS, COST_OF_MARKED = 0.37, 7.5
COST_OF_CHANGE = 0.15
# Most batches that are searched whole before cells are tried again.
MOST_PAUSE = 32
# Kinds of weights of a cell: after an even or an odd number of steps along y, and along x.
_KINDS = 4
# Levels that are tried to find the largest weight of all, and by how much the first is below what
# is asked for, as a share of what that is above the usual bound (docs/constants/search.md).
_MOST_LEVELS = 4
_BELOW = 0.25


class CellTable:
    """Bounds of the weights of all paths, by cells of two by two positions.

    Parameters
    ----------
    graph : StateGraph
        The states.
    grid_shape : tuple of int
        (Y, X) of the positions.
    n_threads : int
        Threads that share the rows.

    Attributes
    ----------
    best : array, shape (Y // 2 + 1, X // 2 + 1)
        No path that starts its last segment in a cell weighs more.
    """

    def __init__(self, graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1):
        coarse, layout, rows = _cells_of(graph, grid_shape)
        self._layout, self._last = layout, graph.n_segments - 1
        self._over_rows = RowThreads(layout.n_y, n_threads)
        motion = motion_of(coarse, np.zeros(graph.n_velocities, np.int64), None)
        size_of_kind = graph.n_frames * layout.n_y * layout.stride
        kinds = 2 * (graph.moves[:, :, 1] % 2) + graph.moves[:, :, 0] % 2
        self._segments = []
        for j in range(graph.n_segments):
            segment = segment_of(coarse, j, layout, motion)
            kind = kinds[graph.knots[j]:graph.knots[j + 1]].T
            self._segments.append(
                segment._replace(offsets=segment.offsets + kind.astype(np.int64) * size_of_kind))
        self._odd = graph.end_moves.astype(np.int64) % 2
        # What arrives is written row by row of velocities, and read as if nothing had moved.
        self._arrived = np.tile(layout.guard + layout.stride * np.arange(layout.n_v),
                                (layout.n_y, 1))
        self._still = np.zeros((layout.n_v, 2), np.int64)
        self._pooled = np.full(_KINDS * size_of_kind + margin_of(layout), ABSENT)
        self._places, size = rows.places(), rows.size
        if self._last:
            # In which states paths end is asked as well.
            self._places = np.append(self._places, size - layout.guard + self._places[:1], axis=0)
            size += layout.n_y * layout.n_v * layout.stride
        self._table = absent_rows(1, size + margin_of(layout))[0]
        # Only what is written of it takes memory.
        self._rests = np.empty((2 if self._last else 0, layout.n_y * layout.n_v * layout.lanes),
                               np.float32)
        self._all = np.full((layout.n_y, layout.n_v), ~np.uint64(0) >> np.uint64(
            viterbi.BLOCKS - -(-layout.lanes // layout.block)))
        self.best = np.empty((layout.n_y, layout.n_x), np.float32)

    def fill(self, scores: NDArray, per_frame: float) -> None:
        """Compute all bounds for scores (T, Y, X) of positions."""
        self._over_rows(cells.pool_scores, self._pooled, np.ascontiguousarray(scores),
                        np.float32(per_frame), self._layout)
        for j, segment in enumerate(self._segments):
            arriving = placed(segment, j, self._places)
            if j:
                arriving = arriving._replace(arrival=self._still, places_before=self._arrived)
            self._over_rows(
                cells.extend_cells, self._table if self._last else NO_STATES,
                self.best if j == self._last else NO_ENDS, self._table if j else NO_STATES,
                self._pooled, arriving, self._layout, segment.arrival, self._odd[max(j - 1, 0)],
                self._places[j - 1] if j else segment.places, self._all, self._all[:, 0].copy())

    def mark(self, level: float, of_positions: viterbi.Layout,
             most: float) -> tuple[NDArray[np.uint64] | None, int]:
        """Return the states (J, Y, V) that may be on a path of a weight of ``level`` or more.

        In blocks of positions, laid out as ``of_positions`` says, and how many these are; None
        where that is more than ``most``, of which some are counted.
        """
        marks = np.zeros((self._last + 1, of_positions.n_y, of_positions.n_v), np.uint64)
        n_marked = cells.mark_ends(marks[-1], self.best, np.float32(level), of_positions)
        if n_marked <= most and self._last:
            for number, (rest, alive) in enumerate(self._alive(level)):
                if number:
                    n_marked += cells.mark_positions(marks[-1 - number], rest, alive,
                                                     self._layout, of_positions)
                if n_marked > most:
                    break
        return marks if n_marked <= most else None, n_marked

    def _alive(self, level: float) -> Iterator[tuple[NDArray, NDArray[np.uint64]]]:
        """Yield what follows the states on paths of such a weight, and where they are.

        For the last segment first.
        """
        layout, bound = self._layout, np.float32(level)
        (rest, before), alive = self._rests, np.zeros_like(self._all)
        cells.begin_rest(rest, alive, self.best, self._table, self._places[-1], bound, layout)
        yield rest, alive
        for j in range(self._last - 1, -1, -1):
            alive_before, segment = np.zeros_like(alive), self._segments[j + 1]
            cells.rest_before(before, alive_before, rest, alive, self._table, self._pooled,
                              segment, layout, segment.arrival, self._odd[j], self._places[j],
                              bound)
            rest, before, alive = before, rest, alive_before
            yield rest, alive


class MarkedTable(ViterbiTable):
    """The best paths through some of the states."""

    @property
    def layout(self) -> viterbi.Layout:
        """Return where the positions lie."""
        return self._layout

    def store(self, scores: NDArray, per_frame: float) -> float:
        """Keep scores (T, Y, X), less what a frame costs; return the rounding of a sum."""
        if not len(self._scores):
            self._take_memory_of_scores()
        self._store(scores, per_frame)
        return self._rounding()

    def search(self, marks: NDArray[np.uint64]) -> float:
        """Compute the marked states (J, Y, V); return the largest weight of paths through them."""
        places = np.zeros((len(marks) - 1, *marks.shape[1:]), np.int64)
        size = self._layout.guard
        for j in range(len(places)):
            after = self._segments[j + 1]
            size = cells.place_marked(places[j], marks[j], marks[j + 1], after.arrival,
                                      after.turns, self._layout, size)
        self._place(places, size)
        self.best.fill(ABSENT)
        self._traced.clear()
        self._compute(marks, marks[-1, :, :1].T.copy())
        return float(self.best.max())


class CoarseToFine:
    """The best paths of a graph, searched among cells first: as a :class:`ViterbiTable` has them.

    Where many states pass, all are computed instead, and in the next batches from the start: what
    is in them is much like what was in the last.

    Parameters
    ----------
    graph, grid_shape, n_threads, most_bytes
        As there.

    Attributes
    ----------
    cells_first : bool
        Whether cells are searched first in the frames at hand.
    """

    def __init__(self, graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1,
                 most_bytes: float = math.inf):
        self._of_table = graph, grid_shape, n_threads
        self._most_bytes = most_bytes
        n_bytes = cell_bytes(graph, grid_shape) + table_bytes(graph, grid_shape,
                                                              most_bytes=most_bytes)
        self._both_fit = n_bytes <= most_bytes
        self._marked = MarkedTable(graph, grid_shape, n_threads)
        layout = self._marked.layout
        self._n_blocks = graph.n_segments * layout.n_y * layout.n_v * -(
            -layout.lanes // layout.block)
        self._cells: CellTable | None = None
        self._table: ViterbiTable | None = None
        self.cells_first = True
        # Times that changed scores were searched, and what that took beside a fill of all states.
        self._n_changes, self._work = 0, 0.0
        # Batches before cells are tried again, and how many it were the last time.
        self._wait, self._pause = 0, 1
        self._scores, self._per_frame = np.empty((0, 0, 0), np.float32), 0.0
        # By how much sums along a path may be rounded, None before the first.
        self._margin: float | None = None
        # All paths that weigh more are known, and the largest weight.
        self._level = self._largest = math.inf

    def fill(self, scores: NDArray, per_frame: float = 0.0) -> float:
        """Return the largest weight for scores of shape (T, Y, X)."""
        return self.update(scores, math.inf, None, per_frame)

    def update(self, scores: NDArray, level: float, rows: NDArray | None = None,
               per_frame: float = 0.0) -> float:
        """Return the largest weight; all paths that weigh more than ``level`` are known then."""
        self._scores, self._per_frame = scores, per_frame
        changed = self._n_changes == 0 or rows is None or bool(rows.any())
        self._n_changes += changed
        if not self.cells_first:
            return self._whole().update(scores, level, rows, per_frame)
        if not changed and level >= self._level:
            return self._largest
        if changed:
            if self._cells is None:
                self._cells = CellTable(*self._of_table)
            self._work += COST_OF_CELLS
            self._cells.fill(scores, per_frame)
            self._margin = self._marked.store(scores, per_frame)
        assert self._cells is not None and self._margin is not None
        # Where nothing passes, the largest weight of all is likely to be found a little below.
        usual = float(np.median(self._cells.best))
        level = min(level, float(self._cells.best.max()) + self._margin)
        level -= _BELOW * (level - usual)
        known = float(ABSENT)
        for attempt in range(_MOST_LEVELS):
            largest = self._search(level)
            if largest is None or largest >= level:
                break
            # What happens to be marked holds paths as well.
            known = max(known, largest)
            last = attempt == _MOST_LEVELS - 2
            level = known if last else max(known, 0.5 * (level + usual))
        if largest is None or largest < level:
            return self._give_up(level)
        self._largest = largest
        return largest

    def forget(self) -> None:
        """Search the next frames from the start."""
        if self._n_changes == 0:
            # None were searched since.
            return
        self.cells_first, self._margin = self._are_next(), None
        self._n_changes, self._work = 0, 0.0
        if self._table is not None:
            self._table.forget()
        if self.cells_first and not self._both_fit:
            self._table = None

    def _are_next(self) -> bool:
        """Return whether cells are searched first in the next frames, by what these have taken."""
        if self._margin is None:
            self._wait -= 1
        elif self.cells_first and self._work <= 1 + COST_OF_CHANGE * (self._n_changes - 1):
            self._pause = 1
        else:
            self._wait = self._pause = min(2 * self._pause, MOST_PAUSE)
        return self._wait <= 0

    def best_paths(self, above: float, radius: int, limit: int) -> list[TracedPath]:
        """Return paths as :meth:`ViterbiTable.best_paths` does."""
        if self.cells_first and above < self._level and self._search(above) is None:
            self._give_up(above)
        table = self._marked if self.cells_first else self._whole()
        return table.best_paths(above, radius, limit)

    def _search(self, level: float) -> float | None:
        """Find all paths of a level or more; return the largest weight of a path that is known.

        None where that would take longer than to compute all states.
        """
        assert self._cells is not None and self._margin is not None
        marks, n_marked = self._cells.mark(level - self._margin, self._marked.layout,
                                           self._n_blocks / COST_OF_MARKED)
        self._work += COST_OF_MARKED * n_marked / self._n_blocks
        if marks is None:
            return None
        self._level = level
        return self._marked.search(marks)

    def _give_up(self, level: float) -> float:
        """Compute all states, now and until other frames come."""
        self.cells_first = False
        return self._whole().update(self._scores, level, None, self._per_frame)

    def _whole(self) -> ViterbiTable:
        if not self._both_fit:
            self._cells = None
        if self._table is None:
            self._table = ViterbiTable(*self._of_table, most_bytes=self._most_bytes)
        return self._table


PathTable = ViterbiTable | CoarseToFine


def path_table(graph: StateGraph, grid_shape: tuple[int, int], n_threads: int = 1,
               kinds: NDArray | None = None, presence: Presence | None = None,
               most_bytes: float = math.inf, few_pass: bool = True) -> PathTable:
    """Return the table that is quickest; parameters as of :class:`ViterbiTable`.

    ``few_pass`` says that the levels which are asked for are passed by few states.
    """
    n_states = graph.n_segments * graph.n_velocities * float(np.prod(grid_shape))
    if (cells_may_lead(few_pass, kinds is not None, presence is not None)
            and n_states >= LEAST_STATES and graph.n_velocities >= LEAST_VELOCITIES
            and cell_bytes(graph, grid_shape) <= most_bytes):
        return CoarseToFine(graph, grid_shape, n_threads, most_bytes)
    return ViterbiTable(graph, grid_shape, n_threads, kinds, presence, most_bytes)


def cells_may_lead(few_pass: bool, has_kinds: bool, has_presence: bool) -> bool:
    """Return whether :func:`path_table`, told such, may seek paths among cells first."""
    return few_pass and not has_kinds and not has_presence


def cell_bytes(graph: StateGraph, grid_shape: tuple[int, int]) -> int:
    """Return the memory of a :class:`CellTable`, the states that are alive at most included."""
    _, layout, rows = _cells_of(graph, grid_shape)
    # The states of the last segment, and those alive in two at a time.
    n_more = 3 if graph.n_segments > 1 else 0
    return rows.n_bytes + NO_STATES.itemsize * layout.n_y * layout.stride * (
        _KINDS * graph.n_frames + n_more * layout.n_v)


def _cells_of(graph: StateGraph,
              grid_shape: tuple[int, int]) -> tuple[StateGraph, viterbi.Layout, HeldRows]:
    """Return the paths of cells, where the cells lie, and the rows of their table."""
    coarse = replace(graph, moves=-(-graph.moves // 2), end_moves=-(-graph.end_moves // 2))
    layout = layout_of(coarse, (grid_shape[0] // 2 + 1, grid_shape[1] // 2 + 1), spare=1)
    # Whole blocks of a row are written.
    lanes = layout.block * -(-layout.lanes // layout.block)
    layout = layout._replace(lanes=lanes, stride=max(layout.stride, lanes),
                             guard=layout.guard + layout.block)
    return coarse, layout, HeldRows(coarse, layout, math.inf)


def search_once() -> None:
    """Run every loop, so that it is compiled: batches that are large enough take long."""
    graph = build_state_graph(np.arange(8.0), step_px=1.0, max_speed=1.7, max_acceleration=0.4,
                              turn_cost=0.5)
    scores = np.random.default_rng(0).exponential(size=(8, 80, 80)).astype(np.float32)
    scores[:, 40, 40] += 30
    table = CoarseToFine(graph, scores.shape[1:])
    table.update(scores, 230.0)
    table.best_paths(230.0, 2, 1)
