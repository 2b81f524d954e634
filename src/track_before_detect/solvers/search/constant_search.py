"""Search of the best paths for amplitudes that are constant (DP over sums of n h).

With equal norms n of all columns the statistic of a path is the sum of its h over sqrt(T), which
the path search adds up as it is; amplitudes of either sign take one pass for each sign.

Where variance or mask make the norms differ, the statistic (sum of n h) / |n| is not additive, and
a few searches of sums that are take its place: see the module ``ratio_search``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.search.path_search import FoundPath, PathSearch
from track_before_detect.solvers.search.position_scores import PositionScores
from track_before_detect.solvers.search.ratio_search import best_new, paths_over_tilts
from track_before_detect.solvers.search.viterbi_table import ViterbiTable


class ConstantSearch(PathSearch):
    """Finds the best paths of constant amplitudes, whatever the norms of their columns.

    Parameters
    ----------
    graph, psf, shape, model, n_threads
        As for PathSearch.
    """

    def __init__(self, graph: StateGraph, psf: Psf, shape: tuple[int, int],
                 model: AmplitudeModel, n_threads: int = 1):
        super().__init__(graph, psf, shape, model, n_threads)
        assert isinstance(self._scores, PositionScores)
        self._positions = self._scores
        self._signs = model.signs
        self._tables = [self._table, *(ViterbiTable(graph, self.grid_shape, n_threads)
                                       for _ in self._signs[1:])]

    def forget(self) -> None:
        """Search the next frames without looking for what they share with the last."""
        super().forget()
        for table in self._tables:
            table.forget()

    def best_value(self, frames: NDArray) -> float:
        """Return the largest value of any path; where norms differ 0 when none is above."""
        if self._positions.shares is not None:
            return self.best_paths(frames, 0.0, 1.0, lambda _: True, 1)[0]
        scores = self.scores(frames)
        return max(float(self.run(sign * scores).max()) for sign in self._signs)

    def best_paths(self, frames: NDArray, above: float, separation: float,
                   is_new: Callable[[NDArray], bool], limit: int,
                   ) -> tuple[float, list[FoundPath]]:
        """Return the largest value of any path, and separate paths with values above a bound.

        Where norms differ, the bound is returned in place of a largest value below it.
        """
        radius = max(1, round(separation / self.graph.step_px))
        if self._positions.shares is not None:
            return self._uneven_paths(self._positions.shares, frames, above, radius, is_new,
                                      limit)
        scores = self.scores(frames)
        largest = max(table.update(sign * scores, above)
                      for sign, table in zip(self._signs, self._tables, strict=True))
        found = [path for table in self._tables
                 for path in self._paths_of(table, above, radius, limit)]
        return largest, best_new(found, is_new, limit)

    def _uneven_paths(self, shares, frames, above, radius, is_new, limit):
        """Return what ``best_paths`` does where the norms of columns differ."""
        squares = np.where(shares > LEAST_SHARE, shares, np.float32(0))
        per_frame = len(frames) / len(squares)
        most, least = (max(per_frame * float(sum(one(axis=(1, 2)))), LEAST_SHARE)
                       for one in (squares.max, squares.min))
        found: list[FoundPath] = []
        level = above
        for sign, table in zip(self._signs, self._tables, strict=True):
            level, paths = paths_over_tilts(
                partial(self._tilted, table, frames, squares, sign, above, radius, limit),
                level, most, least)
            found += [path for path in paths if path.value > above]
        return level, best_new(found, is_new, limit)

    def _tilted(self, table, frames, squares, sign, above, radius, limit, tilt):
        """Return the largest sum of n h - tilt n^2, and the paths that surely are above a bound.

        The best path is among them wherever it is.
        """
        root = math.sqrt(len(frames))
        scores = self._positions.scores(frames, sign / root, tilt / root)
        table.fill(self._sheared(scores))
        largest = float(table.best.max())
        passing = above**2 / (4 * tilt * root) if tilt else 0.0
        bound = min(passing, float(np.nextafter(np.float32(largest), np.float32(-np.inf))))
        frame = np.arange(len(frames))
        found = []
        for path in self._paths_of(table, bound, radius, limit):
            x, y = np.rint(path.positions.T / self.graph.step_px).astype(int)
            square = float(squares[frame if len(squares) > 1 else 0, y, x].sum(dtype=float))
            product = (root * float(scores[frame, y, x].sum(dtype=float)) + tilt * square
                       - root * path.cost)
            found.append(replace(path, value=product / math.sqrt(square) if square else 0.0))
        return root * largest, found
