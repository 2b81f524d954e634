"""Search of the best paths of constant amplitude that may enter and leave during the batch.

The statistic (sum of n h) / |n| is taken over the frames in which a target is there. The longer it
is there the larger is |n|, so the statistic is not additive even where every frame counts alike:
the module ``ratio_search`` finds its largest value by searches in which each frame costs tau n^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.kernels.search.viterbi import ABSENT
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.partial_search import PartialSearch
from track_before_detect.solvers.search.path_search import FoundPath
from track_before_detect.solvers.search.position_scores import PositionScores
from track_before_detect.solvers.search.ratio_search import best_new, paths_over_tilts


class ConstantPartialSearch(PartialSearch):
    """Finds the best paths of constant amplitude, in all frames or in some.

    Parameters
    ----------
    graph, psf, shape, model, presence, n_threads
        As for PartialSearch.
    """

    def __init__(self, graph: StateGraph, psf: Psf, shape: tuple[int, int],
                 model: AmplitudeModel, presence: Presence, n_threads: int = 1):
        super().__init__(graph, psf, shape, model, presence, n_threads)
        assert isinstance(self._scores, PositionScores)
        self._positions = self._scores
        self._signs = model.signs
        self._price = presence

    def best_value(self, frames: NDArray) -> float:
        """Return the largest value of any path, 0 when none is above."""
        return self.best_paths(frames, 0.0, 1.0, lambda _: True, 1)[0]

    def best_paths(self, frames: NDArray, above: float, separation: float,
                   is_new: Callable[[NDArray], bool], limit: int,
                   ) -> tuple[float, list[FoundPath]]:
        """Return the largest value of any path, and separate paths with values above a bound.

        The bound is returned in place of a largest value below it.
        """
        radius = max(1, round(separation / self.graph.step_px))
        squares = self._squares()
        per_frame = len(frames) / len(squares)
        most = max(per_frame * float(sum(square.max() for square in squares)), LEAST_SHARE)
        there = squares[squares > 0]
        least = max(float(there.min()) if len(there) else 0.0, LEAST_SHARE)
        found: list[FoundPath] = []
        level = above
        root = math.sqrt(len(frames))
        for sign in self._signs:
            if self._positions.shares is None:
                # A frame then costs the same everywhere, so all tilts have these scores.
                even = self._positions.scores(frames, sign / root)
                look = partial(self._evenly_tilted, even, squares, above, radius, limit)
            else:
                look = partial(self._tilted, frames, squares, sign, above, radius, limit)
            level, paths = paths_over_tilts(look, level, most, least)
            found += [path for path in paths if path.value > above]
        return level, best_new(found, is_new, limit)

    def _squares(self):
        """Return n^2 of each position, of one frame or all."""
        shares = self._positions.shares
        if shares is None:
            return np.ones((1, *self.grid_shape), np.float32)
        return np.where(shares > LEAST_SHARE, shares, np.float32(0))

    def _evenly_tilted(self, scores, squares, above, radius, limit, tilt):
        """Return what ``_tilted`` does where n is one, of scores h over the root of the frames."""
        self._presence = replace(self._price, per_frame=tilt / math.sqrt(len(scores)))
        return self._passing(scores, 0.0, squares, above, radius, limit, tilt)

    def _tilted(self, frames, squares, sign, above, radius, limit, tilt):
        """Return the largest sum of n h - tilt n^2, and the paths that surely are above a bound.

        The best path is among them wherever it is.
        """
        root = math.sqrt(len(frames))
        self._presence = self._price
        scores = self._positions.scores(frames, sign / root, tilt / root)
        return self._passing(scores, tilt, squares, above, radius, limit, tilt)

    def _passing(self, scores, taken, squares, above, radius, limit, tilt):
        """Return what ``_tilted`` does, of scores that have taken * n^2 taken off already."""
        root = math.sqrt(len(scores))
        ends = self.run(self._sheared(scores))
        largest = float(ends.max())
        passing = max(above, 0.0)**2 / (4 * tilt * root) if tilt else 0.0
        bound = min(passing, float(np.nextafter(np.float32(largest), np.float32(ABSENT))))
        found = []
        for path in self._ended_paths(ends, bound, radius, limit):
            [frame] = np.nonzero(np.isfinite(path.positions[:, 0]))
            x, y = np.rint(path.positions[frame].T / self.graph.step_px).astype(int)
            square = float(squares[frame if len(squares) > 1 else 0, y, x].sum(dtype=float))
            cost = path.cost - self._presence.per_frame * len(frame)
            product = (root * (float(scores[frame, y, x].sum(dtype=float)) - cost)
                       + taken * square)
            found.append(replace(path, cost=cost,
                                 value=product / math.sqrt(square) if square else 0.0))
        return root * largest, found
