"""The tail of the strongest paths that are no target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import logsumexp

# Most paths that the tail is fitted to: few, because clutter differs further in.
MOST_PATHS = 40
# Places at which a path can be, for each path of the tail.
PLACES = 8
# Powers of the statistic that may be exponential: that of noise, and those of clutter.
SHAPES = np.array([2.0, 1.0, 0.5])
# Share of the paths of a tail that may be targets as well.
TARGETS = 0.25
# Part of the largest statistic that stands for one of nothing, which has no logarithm.
LEAST_OF_LARGEST = 1e-3


@dataclass(frozen=True)
class PathTail:
    """Statistics of separate paths, Weibull distributed beyond a start.

    In noise it is their square that is exponential. Clutter, whose level differs from place to
    place, reaches further out: as in the amplitudes of radar clutter it is a lower power (Sekine
    and Mao, Weibull radar clutter, 1990).

    Attributes
    ----------
    start : float
        Statistic at which the tail begins.
    totals : array, shape (S,)
        Sum of the excesses of the paths beyond, in each power of :data:`SHAPES`.
    weights : array, shape (S,)
        Probability that it is this power that is exponential.
    count : int
        Number of paths beyond.
    """

    start: float
    totals: NDArray[np.float64]
    weights: NDArray[np.float64]
    count: int

    def chance(self, statistic: float) -> float:
        """Return how many paths are expected to pass a statistic, those of the tail and one more.

        The scale is known from as many excesses as there are; an excess over their mean is Pareto
        distributed, which adds what they do not tell. So is the power, each of which counts for as
        much as it explains them.
        """
        if not self.totals.all():
            return float(self.count + 1) if statistic < self.start else 0.0
        excess = np.maximum(statistic**SHAPES - self.start**SHAPES, 0.0)
        passing = (1 + excess / self.totals) ** -self.count
        return float((self.count + 1) * (self.weights @ passing))

    def threshold(self, rate: float, share: float = 1.0) -> float:
        """Return what the largest statistic, which is none of these, passes with a probability.

        Parameters
        ----------
        rate : float
            The probability.
        share : float
            Of the frame, in which it is to hold.
        """
        wanted = rate / share
        if wanted >= self.count + 1 or not self.totals.all():
            return self.start
        beyond = (wanted / (self.count + 1)) ** (-1 / self.count) - 1
        alone = (self.start**SHAPES + self.totals * beyond) ** (1 / SHAPES)
        # Rounding may leave an end of what brackets the level on its wrong side.
        return float(brentq(lambda level: self.chance(level) - wanted,
                            (1 - 1e-9) * alone.min(), (1 + 1e-9) * alone.max()))


def tail_behind(statistics: ArrayLike, n_places: float, rate: float) -> PathTail:
    """Return the tail of the paths that are no targets, of those behind the strongest of a batch.

    Several targets of one strength would each be hidden by the others, as part of the tail that
    it has to pass. As many are left out of it as can be, of which the weakest still passes the
    tail of the rest (Rosner, Percentage points for a generalized ESD many-outlier procedure,
    1983).

    Parameters
    ----------
    statistics, n_places
        As of :func:`path_tail`.
    rate : float
        Probability with which the strongest of a tail passes it.
    """
    ordered = np.sort(np.asarray(statistics, float))[::-1]
    whole = path_tail(ordered, n_places)
    for n_targets in range(int(TARGETS * whole.count), 0, -1):
        tail = path_tail(ordered[n_targets:], n_places)
        if tail.chance(ordered[n_targets - 1]) < rate:
            return tail
    return whole


def path_tail(statistics: ArrayLike, n_places: float) -> PathTail:
    """Return the tail of the strongest separate paths of a batch.

    Parameters
    ----------
    statistics : array
        Of separate paths, all beyond some value; at least two.
    n_places : float
        Separate places at which a path can be.
    """
    ordered = np.sort(np.asarray(statistics, float))[::-1]
    count = int(np.clip(round(n_places / PLACES), 2, min(MOST_PATHS, len(ordered) - 1)))
    start, largest = float(ordered[count]), float(ordered[0])
    beyond = ordered[:count, None]
    totals = np.sum(beyond**SHAPES - start**SHAPES, axis=0)
    weights = np.full(len(SHAPES), 1 / len(SHAPES))
    if totals.all():
        logarithms = np.log(np.maximum(beyond, LEAST_OF_LARGEST * largest)).sum()
        likelihoods = count * (np.log(SHAPES) - np.log(totals)) + (SHAPES - 1) * logarithms
        weights = np.exp(likelihoods - logsumexp(likelihoods))
    return PathTail(start, totals, weights, count)
