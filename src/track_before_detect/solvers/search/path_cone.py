"""All that the paths to a few positions may have come by, computed anew.

Paths fan out slowly: they turn by few steps between two segments. So what the paths to neighbouring
positions may have come by is a small part of the table, and where that was not kept it is computed
again, by the same loops and to the same last bit.
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

    Attributes
    ----------
    velocities : array of int64, shape (N,)
        Those that they may have.
    low, high : array of int64, shape (N, 2)
        Smallest and largest x and y by velocity.
    height, width : int
        Rows, and numbers of a row in whole blocks, that hold those of any velocity.
    """

    velocities: NDArray[np.int64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    height: int
    width: int


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

    Attributes
    ----------
    size : int
        Numbers that their states take.
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
        self.size = self._first[-1] + layout.guard

    def fill(self, tables: NDArray, scores: NDArray, y: int, x: int) -> NDArray[np.int64]:
        """Compute all that may lead to the positions from (y, x) on.

        Parameters
        ----------
        tables : array of float32, shape (size or more,)
            Receives the states.
        scores : array of float32, flat
            As in the module ``viterbi``.

        Returns
        -------
        array of int64, shape (J - 1, Y, V)
            Where the states lie, as of ``viterbi_backtrack.best_end``.
        """
        n_y, n_v = self._layout.n_y, self._layout.n_v
        tables[:self.size] = ABSENT
        places = np.zeros((len(self._extents), n_y, n_v), np.int64)
        nowhere = np.zeros(n_y, np.uint64)
        before = NO_STATES
        for j, extent in enumerate(self._extents):
            marks, rows = self._mark(places[j], self._first[j], extent, y, x)
            viterbi.extend_paths(tables, NO_ENDS, before, scores,
                                 placed(self._segments[j], j, places), self._layout,
                                 self._end_costs[j], marks, nowhere, *rows)
            before = tables
        return places

    def _mark(self, places: NDArray, first: int, extent: _Extent, y: int, x: int,
              ) -> tuple[NDArray[np.uint64], tuple[int, int]]:
        """Write where the states of a segment lie; return their blocks (Y, V), and their rows."""
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
        marks = np.zeros((layout.n_y, layout.n_v), np.uint64)
        begin = first + (k * len(v) + np.arange(len(v))) * extent.width
        begin -= left // layout.block * layout.block
        seen, number = rows[held], np.nonzero(held)[1]
        marks[seen, v[number]] = blocks[number]
        places[seen, v[number]] = begin[held]
        return marks, (int(seen.min()), int(seen.max()) + 1) if len(seen) else (0, 0)


def _largest_near(values: NDArray[np.int64], turns: viterbi.Turns) -> NDArray[np.int64]:
    """Return the largest of values (V, 2) among the velocities within reach of each."""
    on_grid = np.full((turns.velocity_at.size, 2), np.iinfo(np.int64).min)
    on_grid[turns.slots] = values
    for step in (1, turns.columns):
        on_grid = np.max([np.roll(on_grid, k * step, axis=0)
                          for k in range(-turns.reach, turns.reach + 1)], axis=0)
    return on_grid[turns.slots]
