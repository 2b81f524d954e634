"""Largest (sum of p) / |n| over paths, from searches of sums alone.

What a path of constant amplitude adds up, p = n h in each frame less the cost of its turns, is
divided by the norm |n| of its column. With n that differ between paths that is not additive. For
every mu > 0

    sum p - lam |n| >= sum p - lam |n|^2 / (2 mu) - lam mu / 2,

with equality at mu = |n|, so that a path passes lam if and only if some mu shows it, and for each
mu the right-hand side is additive. Let m(tau) be the largest sum of p - tau n^2 of any path. It
is the maximum of straight lines in tau, hence convex, and lies below its chords between places
where it is known: with tau = lam / (2 mu) that bounds what any mu might show, and the next place
to look at is where the bound is largest. It ends when no bound is left above zero, mostly after
two to six searches.
"""

from collections.abc import Callable, Sequence
from functools import partial
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.kernels.rows import ABSENT
from track_before_detect.models.measurement.base import Scores
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.coarse_to_fine import PathTable
from track_before_detect.solvers.search.path_tracer import TracedPath

# Share of lambda to which the largest statistic is known where norms differ: that of sums in
# single precision.
EXACT = 3e-6
# Most passes over all paths for one sign; the bound that is left then is returned.
MOST_TILTS = 60
# Two tilts are this far apart at least, and a new one this share of an interval from its ends.
LEAST_STEP = 1e-5
INSIDE = 0.05


class Ratio:
    """The statistic of a constant amplitude, from a few searches for each sign.

    Where all n are one, a frame costs tau wherever the path is, so that all tilts share their
    scores.

    Parameters
    ----------
    scores, tables
        As of :class:`Additive`.
    presence : Presence, optional
        Cost of being present; without it a path lasts from the first frame to the last.
    """

    def __init__(self, scores: Scores, tables: Sequence[tuple[int, PathTable]],
                 presence: Presence | None):
        self._scores = scores
        self._tables = tables
        self._presence = presence

    def largest(self, frames: NDArray) -> float:
        """Return the largest value of any path, 0 when none is above."""
        return self.best(frames, 0.0, 1, 1)[0]

    def best(self, frames: NDArray, above: float, radius: int, limit: int,
             ) -> tuple[float, list[TracedPath]]:
        """Return the largest value of any path, and paths of values above a bound, apart.

        The bound is returned in place of a largest value below it. Paths may come several times.
        """
        n_frames, squares = len(frames), self._scores.squares
        most, least = float(n_frames), 1.0 if self._presence else float(n_frames)
        if squares is not None:
            most, least = self._bounds(squares, n_frames)
        found: list[TracedPath] = []
        level = above
        for sign, table in self._tables:
            even = None
            if squares is None:
                even = self._scores.scores(frames, sign / math.sqrt(n_frames))
            search = partial(self._tilted, table, frames, even, sign, above, radius, limit)
            level, paths = paths_over_tilts(search, level, most, least)
            found += [path for path in paths if path.value > above]
        return level, found

    def _bounds(self, squares: NDArray, n_frames: int) -> tuple[float, float]:
        """Return the largest and the smallest |n|^2 that a path can have."""
        n_kinds = 1 if self._scores.kinds is None else int(self._scores.kinds.max()) + 1
        by_frame = squares.reshape(n_kinds, -1, *squares.shape[1:])
        per_frame = n_frames / by_frame.shape[1]
        most = per_frame * float(sum(by_frame.max(axis=(0, 2, 3))))
        if self._presence:
            there = squares[squares > 0]
            least = float(there.min()) if len(there) else 0.0
        else:
            least = per_frame * float(sum(by_frame.min(axis=(0, 2, 3))))
        return max(most, LEAST_SHARE), max(least, LEAST_SHARE)

    def _tilted(self, table: PathTable, frames: NDArray, even: NDArray | None, sign: int,
                above: float, radius: int, limit: int, tilt: float,
                ) -> tuple[float, list[TracedPath]]:
        """Return the largest sum of n h - tilt n^2, and the paths that surely are above a bound.

        The best path is among them wherever it is. ``even`` are the scores where all n are one.
        """
        root = math.sqrt(len(frames))
        if even is not None:
            scores = even
            largest = table.fill(scores, tilt / root)
        else:
            scores = self._scores.scores(frames, sign / root, tilt / root)
            largest = table.fill(scores)
        passing = max(above, 0.0)**2 / (4 * tilt * root) if tilt else 0.0
        bound = min(passing, float(np.nextafter(np.float32(largest), np.float32(ABSENT))))
        found = []
        for path in table.best_paths(bound, radius, limit):
            summed, square = self._along(path, scores)
            cost = path.turn_cost
            if self._presence:
                ends = path.frames[[0, -1]]
                cost += self._presence.cost(int(ends[0]), int(ends[1]), len(frames))
            product = root * (summed - cost) + (0.0 if even is not None else tilt * square)
            value = product / math.sqrt(square) if square else 0.0
            found.append(path._replace(value=value))
        return root * largest, found

    def _along(self, path: TracedPath, scores: NDArray) -> tuple[float, float]:
        """Return the sums along a path of scores and of n^2."""
        frame, squares = path.frames, self._scores.squares
        positions = path.positions[frame]
        kinds = self._scores.kinds
        first = 0 if kinds is None else kinds[path.velocities[frame]]
        x, y = positions.astype(int).T
        summed = float(scores[first * len(path.positions) + frame, y, x].sum(dtype=float))
        if squares is None:
            return summed, float(len(frame))
        x, y = self._scores.restore(positions, frame).astype(int).T
        per_kind = len(squares) // (1 if kinds is None else int(kinds.max()) + 1)
        number = first * per_kind + (frame if per_kind > 1 else 0)
        return summed, float(squares[number, y, x].sum(dtype=float))


def paths_over_tilts(search: Callable[[float], tuple[float, list[TracedPath]]], above: float,
                     most: float, least: float) -> tuple[float, list[TracedPath]]:
    """Search at several tilts until no path can be left that passes what is known.

    Parameters
    ----------
    search : callable
        Told a tilt tau >= 0, returns m(tau) and paths, the best among them, with their values
        (sum of p) / |n|.
    above : float
        Value below which the largest need not be known.
    most, least : float
        Bounds of |n|^2 of any path.

    Returns
    -------
    level : float
        The largest value, or ``above`` where it is not larger.
    found : list of TracedPath
        All that were met, some of them more than once.
    """
    level = above
    found: list[TracedPath] = []
    known: list[tuple[float, float]] = []
    tilt = max(level, 0.0) / (2 * math.sqrt(most))
    for _ in range(MOST_TILTS):
        largest, paths = search(tilt)
        known.append((tilt, largest))
        found += paths
        level = max([level, *(path.value for path in paths)])
        excess, tilt = _next_tilt(sorted(known), level, most, least)
        if excess <= EXACT:
            return level, found
    return level * (1 + excess), found


def _next_tilt(known: list[tuple[float, float]], level: float, most: float,
               least: float) -> tuple[float, float]:
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
