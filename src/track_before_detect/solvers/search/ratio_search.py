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

from __future__ import annotations

from collections.abc import Callable, Sequence
import itertools
import math

from numpy.typing import NDArray

from track_before_detect.solvers.search.path_search import FoundPath

# Share of lambda to which the largest statistic is known where norms differ: that of sums in
# single precision.
EXACT = 3e-6
# Most passes over all paths for one sign; the bound that is left then is returned.
MOST_TILTS = 60
# Two tilts are this far apart at least, and a new one this share of an interval from its ends.
LEAST_STEP = 1e-5
INSIDE = 0.05


def paths_over_tilts(look: Callable[[float], tuple[float, list[FoundPath]]], above: float,
                     most: float, least: float) -> tuple[float, list[FoundPath]]:
    """Search at several tilts until no path can be left that passes what is known.

    Parameters
    ----------
    look : callable
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
    found : list of FoundPath
        All that were met, some of them more than once.
    """
    level = above
    found: list[FoundPath] = []
    known: list[tuple[float, float]] = []
    tilt = max(level, 0.0) / (2 * math.sqrt(most))
    for _ in range(MOST_TILTS):
        largest, paths = look(tilt)
        known.append((tilt, largest))
        found += paths
        level = max([level, *(path.value for path in paths)])
        excess, tilt = _next_tilt(sorted(known), level, most, least)
        if excess <= EXACT:
            return level, found
    return level * (1 + excess), found


def best_new(found: Sequence[FoundPath], is_new: Callable[[NDArray], bool],
             limit: int) -> list[FoundPath]:
    """Return the paths of the largest values that are new."""
    ordered = sorted(found, key=lambda path: -path.value)
    return list(itertools.islice((path for path in ordered if is_new(path.positions)), limit))


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
