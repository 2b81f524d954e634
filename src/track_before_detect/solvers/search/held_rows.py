"""Which rows of a table are held, and in which order they are computed.

A row of a segment is read for the rows of the next that its paths arrive in, and for nothing else.
Where the whole table is too large, the segments are therefore computed in turns, a few rows of
each at a time, and hold only the rows that the next has still to read. No state is computed twice.
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
    whole : bool
        Whether all rows are held.

    Attributes
    ----------
    all_held : bool
        Whether all rows are, asked for or not.
    """

    def __init__(self, graph: StateGraph, layout: Layout, whole: bool):
        self._layout, self._n_segments = layout, graph.n_segments
        rows_of_moves = graph.end_moves[:-1, :, 1]
        ahead = np.maximum(0, -rows_of_moves.min(axis=1))
        heights = min(layout.n_y, self._at_once) + ahead + np.maximum(0, rows_of_moves.max(axis=1))
        if whole:
            heights[:] = layout.n_y
        self._heights = np.minimum(heights, layout.n_y)
        # Rows by which a segment is behind the first.
        self._lags = np.cumsum(np.append(0, ahead))
        self.all_held = bool(np.all(self._heights == layout.n_y))

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
        at_once = n_y if self.all_held else self._at_once
        lags = np.zeros_like(self._lags) if self.all_held else self._lags
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
