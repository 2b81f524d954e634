"""Which rows of a table are held, and in which order they are computed.

A row of a segment is read for the rows of the next that its paths arrive in, and for nothing else.
Where the whole table is too large, the segments are therefore computed in turns, a few rows of
each at a time, and the first segments hold only the rows that the next has still to read. No state
is computed twice.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.search.viterbi import Layout
from track_before_detect.models.motion.state_graph import StateGraph

# States computed at a time where not all rows are held (docs/constants/search.md).
STATES_AT_ONCE = 2**22


class HeldRows:
    """The rows of each segment but the last, which is not stored.

    Parameters
    ----------
    graph : StateGraph
        The segments.
    layout : Layout
        How long a row is.
    most_bytes : float
        Memory for them. As many of the last segments as fit are held as a whole, for what changes
        is computed from the last segment that is, and the others hold as little as they can, even
        where that is more.

    Attributes
    ----------
    whole : array of bool, shape (J - 1,)
        Which segments hold all rows.
    """

    def __init__(self, graph: StateGraph, layout: Layout, most_bytes: float):
        self._layout, self._n_segments = layout, graph.n_segments
        rows_of_moves = graph.end_moves[:-1, :, 1]
        ahead = np.maximum(0, -rows_of_moves.min(axis=1))
        self._heights = np.minimum(
            layout.n_y, self._at_once + ahead + np.maximum(0, rows_of_moves.max(axis=1)))
        for j in range(len(self._heights) - 1, -1, -1):
            few, self._heights[j] = self._heights[j], layout.n_y
            if self.n_bytes > most_bytes:
                self._heights[j] = few
                break
        # Rows by which a segment is behind the first.
        self._lags = np.cumsum(np.append(0, ahead))
        self.whole = self._heights == layout.n_y

    @property
    def n_bytes(self) -> int:
        """Memory that the rows take."""
        return np.dtype(np.float32).itemsize * self.size

    @property
    def size(self) -> int:
        """Numbers that the rows take, and the guard before them."""
        return self._layout.guard + int(self._heights.sum()) * self._row

    def places(self) -> NDArray[np.int64]:
        """Return where the states of each segment lie, shape (J - 1, Y, V)."""
        layout = self._layout
        first = self._layout.guard + self._row * np.cumsum(np.append(0, self._heights[:-1]))
        rows = np.arange(layout.n_y) % self._heights[:, None]
        return (first[:len(rows), None, None] + self._row * rows[:, :, None]
                + layout.stride * np.arange(layout.n_v))

    def turns(self) -> Iterator[tuple[int, int, int]]:
        """Yield which segment to compute next, from which row on, and the one past the last."""
        n_y = self._layout.n_y
        at_once, lags = self._at_once, self._lags
        if self.whole.all():
            at_once, lags = n_y, np.zeros_like(lags)
        for progress in range(0, n_y + int(lags[-1]), at_once):
            for j, lag in enumerate(lags):
                first, last = np.clip((progress - lag, progress + at_once - lag), 0, n_y)
                if first < last:
                    yield j, int(first), int(last)

    @property
    def _row(self) -> int:
        return self._layout.n_v * self._layout.stride

    @property
    def _at_once(self) -> int:
        return -(-STATES_AT_ONCE // self._row)
