"""Confidence intervals of what a study estimates, at 95 %."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from track_before_detect.errors import ParameterError

LEVEL = 0.95
_RESAMPLES = 2000

Statistic = Callable[[NDArray], float]


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the Wilson score interval of a share of independent trials."""
    if trials < 1 or not 0 <= successes <= trials:
        raise ParameterError(
            f'successes must be from 0 to trials, and trials at least 1, got {successes} of '
            f'{trials}')
    low, high = stats.binomtest(int(successes), int(trials)).proportion_ci(LEVEL, 'wilson')
    return float(low), float(high)


def poisson_interval(count: int, exposure: float = 1.0) -> tuple[float, float]:
    """Return the exact interval of a Poisson rate: events seen, over what they are counted per."""
    if count < 0 or not exposure > 0:
        raise ParameterError(
            f'count must be at least 0 and exposure above 0, got {count} and {exposure:g}')
    low, high = stats.chi2.ppf([0.5 - LEVEL / 2, 0.5 + LEVEL / 2], [2 * count, 2 * count + 2]) / 2
    # A distribution without degrees of freedom has no quantiles; that of no event is 0.
    return (float(low / exposure) if count else 0.0), float(high / exposure)


def bootstrap_interval(samples: ArrayLike, statistic: Statistic) -> tuple[float, float]:
    """Return the percentile bootstrap interval of a statistic of independent runs.

    Parameters
    ----------
    samples : array, shape (N, ...)
        One entry per run.
    statistic : callable
        Told an array of the same shape, returns a number.
    """
    values = np.asarray(samples)
    if len(values) == 0:
        raise ParameterError('samples must hold at least 1 run, got 0')
    if len(values) == 1:
        return statistic(values), statistic(values)
    # Runs are drawn, not numbers: those of one run stay together. The same draws every time.
    low, high = stats.bootstrap(
        (np.arange(len(values)),), lambda drawn: statistic(values[drawn]), n_resamples=_RESAMPLES,
        confidence_level=LEVEL, method='percentile', vectorized=False,
        random_state=np.random.default_rng(0)).confidence_interval
    return float(low), float(high)
