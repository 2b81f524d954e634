"""All that the paths to one position may have come by, computed anew.

Paths to one position fan out slowly: they turn by few steps between two segments. So what they may
have come by is a small part of the table, and where that was not kept it is computed again, by the
same loops and to the same last bit.
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
NO_STATES = np.empty(0, np.float32)
NO_ENDS = np.empty((0, 0), np.float32)


class _Extent(NamedTuple):
    """Starts of one segment of paths that arrive at a position, from it on.

    Attributes
    ----------
    low, high : array of int64, shape (V, 2)
        Smallest and largest x and y by velocity.
    height, width : int
        Rows, and numbers of a row in whole blocks, that hold those of any velocity.
    """

    low: NDArray[np.int64]
    high: NDArray[np.int64]
    height: int
    width: int


class PathCone:
    """What the paths that start a segment anywhere may have come by.

    Parameters
    ----------
    segments : sequence of Segment
        All segments before it, and itself.
    layout : Layout
        Of the grid.
    end_costs : sequence of (EndCosts or None)
        Of the segments.
    """

    def __init__(self, segments: Sequence[viterbi.Segment], layout: viterbi.Layout,
                 end_costs: Sequence[viterbi.EndCosts | None]):
        self._segments = segments
        self._layout = layout
        self._end_costs = end_costs
        low = high = np.zeros((layout.n_v, 2), np.int64)
        self._extents: list[_Extent] = []
        for segment in segments[:0:-1]:
            low = -_largest_near(-low, segment.turns) - segment.arrival
            high = _largest_near(high, segment.turns) - segment.arrival
            columns, rows = (high - low).max(axis=0) + 1
            # Those of a velocity may begin anywhere in a block.
            blocks = -(-int(columns) // layout.block) + 1
            self._extents.insert(0, _Extent(low, high, int(rows), blocks * layout.block))
        sizes = [extent.height * layout.n_v * extent.width for extent in self._extents]
        # Blocks are read to their ends, also where no path is.
        self._first = (layout.guard + np.cumsum([0, *sizes])).tolist()
        self.size = self._first[-1] + layout.guard

    def fill(self, scores: NDArray, y: int, x: int) -> tuple[NDArray, NDArray[np.int64]]:
        """Compute all that may lead to (y, x).

        Returns
        -------
        tables : array of float32, flat
        places : array of int64, shape (J - 1, Y, V)
            Where the states lie in it, as of ``viterbi_backtrack.follow_back``.
        """
        n_y, n_v = self._layout.n_y, self._layout.n_v
        tables = np.full(self.size, ABSENT)
        places = np.zeros((len(self._extents), n_y, n_v), np.int64)
        nowhere = np.zeros(n_y, np.uint64)
        before = NO_STATES
        for j, extent in enumerate(self._extents):
            marks, rows = self._mark(places[j], self._first[j], extent, y, x)
            viterbi.extend_paths(tables, NO_ENDS, before, scores,
                                 placed(self._segments[j], j, places), self._layout,
                                 self._end_costs[j], marks, nowhere, *rows)
            before = tables
        return tables, places

    def _mark(self, places: NDArray, first: int, extent: _Extent, y: int, x: int,
              ) -> tuple[NDArray[np.uint64], tuple[int, int]]:
        """Write where the states of a segment lie; return their blocks (Y, V), and their rows."""
        n_y, n_x, n_v, block = (self._layout.n_y, self._layout.n_x, self._layout.n_v,
                                self._layout.block)
        (left, top), (right, bottom) = ((x, y) + extent.low).T, ((x, y) + extent.high).T
        k = np.arange(extent.height)[:, None]
        rows = top + k
        held = ((rows <= bottom) & (rows >= 0) & (rows < n_y) & (right >= 0) & (left < n_x))
        lowest = np.maximum(left, 0) // block
        highest = np.minimum(right, n_x - 1) // block
        blocks = np.zeros(n_v, np.uint64)
        there = lowest <= highest
        blocks[there] = ((~_U(0) << lowest[there].astype(_U))
                         & (~_U(0) >> (BLOCKS - 1 - highest[there]).astype(_U)))
        v = np.broadcast_to(np.arange(n_v), held.shape)
        marks = np.zeros((n_y, n_v), np.uint64)
        marks[rows[held], v[held]] = blocks[v[held]]
        begin = first + (k * n_v + v) * extent.width - left // block * block
        places[rows[held], v[held]] = begin[held]
        seen = rows[held]
        return marks, (int(seen.min()), int(seen.max()) + 1) if len(seen) else (0, 0)


def _largest_near(values: NDArray[np.int64], turns: viterbi.Turns) -> NDArray[np.int64]:
    """Return the largest of values (V, 2) among the velocities within reach of each."""
    on_grid = np.full((turns.velocity_at.size, 2), np.iinfo(np.int64).min)
    on_grid[turns.slots] = values
    for step in (1, turns.columns):
        on_grid = np.max([np.roll(on_grid, k * step, axis=0)
                          for k in range(-turns.reach, turns.reach + 1)], axis=0)
    return on_grid[turns.slots]
