"""All that the paths to a few positions may have come by, computed anew.

Paths fan out slowly: they turn by few steps between two segments. So what the paths to
neighbouring positions may have come by is a small part of the table, and where that was not kept
it is computed again, by the same loops and to the same last bit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT
from track_before_detect.kernels.search import viterbi
from track_before_detect.kernels.search.viterbi import BLOCKS
from track_before_detect.solvers.search.compiled_graph import placed

_U = np.uint64
# Rows and columns of positions that share a cone (docs/constants/search.md).
SIDE = 32
# Of a position where no path is.
_FAR = 2**40
NO_STATES = np.empty(0, np.float32)
NO_ENDS = np.empty((0, 0), np.float32)


def place_of_cone(*place: int) -> tuple[int, ...]:
    """Return where the positions begin that share a cone with one, (..., y, x)."""
    *others, y, x = place
    return *others, y // SIDE * SIDE, x // SIDE * SIDE


class _Extent(NamedTuple):
    """Starts of one segment of paths that arrive at some positions, from the first of them on.

    By velocity (N,) their smallest and largest x and y (N, 2); ``height`` rows of ``width``
    numbers, in whole blocks, hold those of any velocity.
    """

    velocities: NDArray[np.int64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    height: int
    width: int


class ConeRoom:
    """Room for the states of a cone, used again for the next: clearing all of it takes longer.

    Attributes
    ----------
    tables : array of float32, flat
        The states.
    places : array of int64, shape (J - 1, Y, V)
        Where they lie, as of ``viterbi_backtrack.trace_paths``.
    marks : array of uint64, shape (Y, V)
        Work space, zero.
    """

    def __init__(self, layout: viterbi.Layout, n_segments: int):
        self.tables = NO_STATES
        self.places = np.zeros((n_segments - 1, layout.n_y, layout.n_v), np.int64)
        self.marks = np.zeros(self.places.shape[1:], np.uint64)
        self._used: list[tuple[int, slice]] = []

    def clear(self, size: int) -> None:
        """Forget what is here, and make room for so many numbers."""
        if len(self.tables) < size:
            self.tables = np.empty(size, np.float32)
        self.tables[:size] = ABSENT
        for j, rows in self._used:
            self.places[j, rows] = 0
        self._used = []

    def use(self, j: int, rows: slice) -> None:
        """Remember that states of these rows of a segment were placed; clear their marks."""
        self._used.append((j, rows))
        self.marks[rows] = 0


class PathCone:
    """What the paths that start a segment in some place may have come by.

    Parameters
    ----------
    segments : sequence of Segment
        All segments before it, and itself.
    layout : Layout
        Of the grid.
    end_costs : sequence of (EndCosts or None)
        Of the segments.
    velocity : int, optional
        That of the paths in their last segment, which then start it all in one position; unless
        given, all that start it in ``SIDE`` rows and columns, with whatever velocity.
    """

    def __init__(self, segments: Sequence[viterbi.Segment], layout: viterbi.Layout,
                 end_costs: Sequence[viterbi.EndCosts | None], velocity: int | None = None):
        self._segments = segments
        self._layout = layout
        self._end_costs = end_costs
        low = np.zeros((layout.n_v, 2), np.int64)
        high = np.full_like(low, SIDE - 1)
        if velocity is not None:
            low[:], high[:] = _FAR, -_FAR
            low[velocity] = high[velocity] = 0
        self._extents: list[_Extent] = []
        for segment in segments[:0:-1]:
            low = -_largest_near(-low, segment.turns) - segment.arrival
            high = _largest_near(high, segment.turns) - segment.arrival
            columns, rows = (high - low).max(axis=0) + 1
            [there] = np.nonzero(low[:, 0] <= high[:, 0])
            # Those of a velocity may begin anywhere in a block.
            blocks = -(-int(columns) // layout.block) + 1
            self._extents.insert(0, _Extent(there, low[there], high[there], int(rows),
                                              blocks * layout.block))
        sizes = [extent.height * len(extent.velocities) * extent.width for extent in self._extents]
        # Blocks are read to their ends, also where no path is.
        self._first = (layout.guard + np.cumsum([0, *sizes])).tolist()
        self._size = self._first[-1] + layout.guard

    def fill(self, room: ConeRoom, scores: NDArray, y: int, x: int) -> None:
        """Compute all that may lead to the positions from (y, x) on.

        ``scores`` are flat, as in the module ``viterbi``.
        """
        room.clear(self._size)
        before = NO_STATES
        for j, extent in enumerate(self._extents):
            rows = self._mark(room.marks, room.places[j], self._first[j], extent, y, x)
            viterbi.extend_paths(room.tables, NO_ENDS, before, scores,
                                 placed(self._segments[j], j, room.places), self._layout,
                                 self._end_costs[j], room.marks, room.marks[:, 0].copy(),
                                 rows.start, rows.stop)
            room.use(j, rows)
            before = room.tables

    def _mark(self, marks: NDArray, places: NDArray, first: int, extent: _Extent, y: int,
              x: int) -> slice:
        """Write which states of a segment there are, and where they lie; return their rows."""
        layout, v = self._layout, extent.velocities
        (left, top), (right, bottom) = ((x, y) + extent.low).T, ((x, y) + extent.high).T
        k = np.arange(extent.height)[:, None]
        rows = top + k
        held = ((rows <= bottom) & (rows >= 0) & (rows < layout.n_y) & (right >= 0)
                & (left < layout.n_x))
        first_block = np.clip(left // layout.block, 0, BLOCKS - 1).astype(_U)
        last_block = np.clip(right // layout.block, 0, BLOCKS - 1).astype(_U)
        blocks = (~_U(0) << first_block) & (~_U(0) >> (_U(BLOCKS - 1) - last_block))
        blocks &= ~_U(0) >> _U(BLOCKS + layout.lanes // -layout.block)
        begin = first + (k * len(v) + np.arange(len(v))) * extent.width
        begin -= left // layout.block * layout.block
        seen, number = rows[held], np.nonzero(held)[1]
        marks[seen, v[number]] = blocks[number]
        places[seen, v[number]] = begin[held]
        return slice(int(seen.min()), int(seen.max()) + 1) if len(seen) else slice(0, 0)


def _largest_near(values: NDArray[np.int64], turns: viterbi.Turns) -> NDArray[np.int64]:
    """Return the largest of values (V, 2) among the velocities within reach of each."""
    on_grid = np.full((turns.velocity_at.size, 2), np.iinfo(np.int64).min)
    on_grid[turns.slots] = values
    for step in (1, turns.columns):
        on_grid = np.max([np.roll(on_grid, k * step, axis=0)
                          for k in range(-turns.reach, turns.reach + 1)], axis=0)
    return on_grid[turns.slots]
