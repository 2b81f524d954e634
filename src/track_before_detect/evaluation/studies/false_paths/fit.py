"""The corrections of theory that make the largest statistics of noise likeliest."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

# Share of the maxima, the largest, that count: below, islands grow together.
SHARE = 0.7
# Levels at which theory is computed, between which its logarithm is nearly a parabola.
N_LEVELS = 12
STEP = 1e-3


class Maxima(NamedTuple):
    """The largest statistics of crops with one set of options.

    Attributes
    ----------
    n_below : int
        Crops whose largest statistic does not count.
    logarithms : array, shape (N + 1,)
        Of the number of paths of theory, where those that count start and at each beyond.
    slopes : array, shape (N,)
        By which these fall at the maxima.
    corrections, correction_slopes : array, shape (N + 1, K) and (N, K)
        What coefficients multiply, and its slopes by the level.
    """

    n_below: int
    logarithms: NDArray[np.float64]
    slopes: NDArray[np.float64]
    corrections: NDArray[np.float64]
    correction_slopes: NDArray[np.float64]

    def counts(self, coefficients: NDArray) -> NDArray[np.float64]:
        """Return how many paths of a crop pass the start, and each maximum, (N + 1,)."""
        return np.exp(self.logarithms + self.corrections @ coefficients)

    def ratio(self, coefficients: NDArray) -> tuple[float, float]:
        """Return the logarithm of paths that came over those expected, and its deviation."""
        # A crop holds none above its largest: as many are expected below as there are crops.
        counts = self.counts(coefficients)
        expected = counts[1:].sum() + self.n_below * counts[0]
        return float(np.log(len(self.slopes) / expected)), len(self.slopes)**-0.5


def maxima_of(values: ArrayLike, theory: Callable[[float], float],
              corrections: Callable[[float], Sequence[float]]) -> Maxima:
    """Return what the fit has to know of the largest statistics of crops.

    Parameters
    ----------
    values : array-like, shape (M,)
        One for each crop.
    theory : callable
        Told a level, returns how many paths of a crop pass it without corrections.
    corrections : callable
        Told a level, returns what coefficients multiply.
    """
    ordered = np.sort(np.asarray(values, float))
    n_below = round(len(ordered) * (1 - SHARE))
    far = ordered[n_below:]
    levels = np.linspace(far[0], far[-1] + 2 * STEP, N_LEVELS)
    logarithms = np.polynomial.Polynomial.fit(
        levels, np.log([theory(float(level)) for level in levels]), 4)
    factors = np.array([corrections(float(level)) for level in far])
    further = np.array([corrections(float(level) + STEP) for level in far[1:]])
    return Maxima(n_below + 1, logarithms(far), -logarithms.deriv()(far[1:]), factors,
                  (further - factors[1:]) / STEP)


def fitted(groups: Sequence[Maxima]) -> tuple[NDArray, NDArray]:
    """Return the likeliest coefficients and their covariance, by how the groups scatter."""
    def unlikely(coefficients: NDArray) -> float:
        total = 0.0
        for one in groups:
            counts = one.counts(coefficients)
            slopes = one.slopes - one.correction_slopes @ coefficients
            total += (counts[1:].sum() + one.n_below * counts[0]
                      - np.log(np.maximum(slopes, STEP) * counts[1:]).sum())
        return float(total)

    found = minimize(unlikely, np.zeros(groups[0].corrections.shape[1]), method='BFGS').x
    scatter = np.mean([np.square(np.divide(*one.ratio(found))) for one in groups])
    # Each maximum is worth one count.
    information = sum(one.corrections[1:].T @ one.corrections[1:] for one in groups)
    return found, np.linalg.inv(information) * max(float(scatter), 1.0)
