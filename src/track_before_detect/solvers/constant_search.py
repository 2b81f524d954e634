"""Search of the best paths for amplitudes that are constant (DP over sums of n h).

With equal norms n of all columns the statistic of a path is the sum of its h over sqrt(T), which
the path search adds up as it is; amplitudes of either sign take one pass for each sign.

Where variance or mask make the norms differ, the statistic (sum of n h) / |n| is not additive. For
every mu > 0

    sum n h - lam |n| >= sum n h - lam |n|^2 / (2 mu) - lam mu / 2,

with equality at mu = |n|, so that a path passes lam if and only if some mu shows it, and for each
mu the right-hand side is additive. Let m(tau) be the largest sum of n h - tau n^2 of any path. It
is the maximum of straight lines in tau, hence convex, and lies below its chords between places
where it is known: with tau = lam / (2 mu) that bounds what any mu might show, and the next place
to look at is where the bound is largest. It ends when no bound is left above zero, mostly after
two to six passes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.stamps import LEAST_SHARE
from track_before_detect.models.amplitudes import AmplitudeModel, SIGNED_CONSTANT
from track_before_detect.models.psf import Psf
from track_before_detect.models.state_graph import StateGraph
from track_before_detect.solvers.path_search import FoundPath, PathSearch
from track_before_detect.solvers.path_table import PathTable
from track_before_detect.solvers.position_scores import PositionScores

# Share of lambda to which the largest statistic is known where norms differ: that of sums in
# single precision.
EXACT = 3e-6
# Most passes over all paths for one sign; the bound that is left then is returned.
MOST_TILTS = 60
# Two tilts are this far apart at least, and a new one this share of an interval from its ends.
LEAST_STEP = 1e-5
INSIDE = 0.05


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
        self._signs = (1, -1) if model.code == SIGNED_CONSTANT else (1,)
        self._tables = [self._table, *(PathTable(graph, self.grid_shape, n_threads)
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
        return largest, _best_new(found, is_new, limit)

    def _uneven_paths(self, shares, frames, above, radius, is_new, limit):
        """Return what ``best_paths`` does where the norms of columns differ."""
        squares = np.where(shares > LEAST_SHARE, shares, np.float32(0))
        per_frame = len(frames) / len(squares)
        most, least = (max(per_frame * float(sum(one(axis=(1, 2)))), LEAST_SHARE)
                       for one in (squares.max, squares.min))
        found: list[FoundPath] = []
        level = above
        for sign, table in zip(self._signs, self._tables, strict=True):
            known: list[tuple[float, float]] = []
            tilt = level / (2 * math.sqrt(most))
            for _ in range(MOST_TILTS):
                largest, paths = self._tilted(table, frames, squares, sign, tilt, above, radius,
                                              limit)
                known.append((tilt, largest))
                found += [path for path in paths if path.value > above]
                level = max([level, *(path.value for path in paths)])
                excess, tilt = _next_tilt(sorted(known), level, most, least)
                if excess <= EXACT:
                    break
            else:
                level *= 1 + excess
        return level, _best_new(found, is_new, limit)

    def _tilted(self, table, frames, squares, sign, tilt, above, radius, limit):
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


def _best_new(found, is_new, limit):
    """Return the paths of the largest values that are new."""
    found.sort(key=lambda path: -path.value)
    return [path for path in found[:limit] if is_new(path.positions)]


def _next_tilt(known, level, most, least):
    """Return by how much a path may still pass a level, as a share of it, and at which tilt.

    Parameters
    ----------
    known : list of (float, float)
        Tilts, ascending, and m at each.
    level : float
        lam.
    most, least : float
        Bounds of |n|^2 of any path: minus the steepest and the flattest slope of m.
    """
    if not level > 0:
        return 0.0, 0.0
    (first, at_first), (last, at_last) = known[0], known[-1]
    lowest, highest = level / (2 * math.sqrt(most)), level / (2 * math.sqrt(least))
    bounds = [(lowest, first, first, at_first, -most), (last, highest, last, at_last, -least)]
    for (left, at_left), (right, at_right) in itertools.pairwise(known):
        slope = (at_right - at_left) / (right - left)
        bounds.append((left, right, left, at_left, min(slope, -least)))
    best = (0.0, 0.0)
    for left, right, anchor, value, slope in bounds:
        left, right = max(left, lowest), min(right, highest)
        if right - left <= LEAST_STEP * right:
            continue
        top = min(max(level / (2 * math.sqrt(-slope)), left), right)
        excess = value + slope * (top - anchor) - level**2 / (4 * top)
        margin = INSIDE * (right - left) if first <= left and right <= last else 0.0
        best = max(best, (excess * 2 * top / level**2,
                          min(max(top, left + margin), right - margin)))
    return best
