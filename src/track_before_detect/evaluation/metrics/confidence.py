"""Confidence intervals of what a study estimates."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from track_before_detect.errors import ParameterError

LEVEL = 0.95
_RESAMPLES = 2000


def wilson_interval(successes: int, trials: int, level: float = LEVEL) -> tuple[float, float]:
    """Return the Wilson score interval of a proportion.

    Parameters
    ----------
    successes : int
        At most ``trials``.
    trials : int
        At least 1, independent.
    level : float
        Confidence, between 0 and 1.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ParameterError(
            f'successes must be from 0 to trials, and trials at least 1, got {successes} of '
            f'{trials}')
    z = float(special.ndtri(0.5 + 0.5 * _checked_level(level)))
    share = successes / trials
    shrink = 1 + z**2 / trials
    centre = (share + z**2 / (2 * trials)) / shrink
    half = z / shrink * math.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    # At the ends the bound is exactly 0 or 1; rounding would put it just beside.
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return low, high


def poisson_interval(count: int, exposure: float = 1.0,
                     level: float = LEVEL) -> tuple[float, float]:
    """Return the exact interval of a Poisson rate.

    Parameters
    ----------
    count : int
        Events seen.
    exposure : float
        What the rate is counted per; above 0.
    level : float
        Confidence, between 0 and 1.
    """
    if count < 0 or not exposure > 0:
        raise ParameterError(
            f'count must be at least 0 and exposure above 0, got {count} and {exposure:g}')
    tail = 0.5 * (1 - _checked_level(level))
    low = 0.0 if count == 0 else float(special.gammaincinv(count, tail))
    high = float(special.gammaincinv(count + 1, 1 - tail))
    return low / exposure, high / exposure


def bootstrap_interval(samples: ArrayLike, statistic: Callable[[NDArray], float],
                       seed: int = 0, level: float = LEVEL) -> tuple[float, float]:
    """Return the percentile bootstrap interval of a statistic of independent runs.

    Parameters
    ----------
    samples : array, shape (N, ...)
        One entry per run.
    statistic : callable
        Told an array of the same shape, returns a number.
    seed : int
        Of the resampling.
    level : float
        Confidence, between 0 and 1.
    """
    values = np.asarray(samples)
    if len(values) == 0:
        raise ParameterError('samples must hold at least 1 run, got 0')
    tail = 0.5 * (1 - _checked_level(level))
    rng = np.random.default_rng(seed)
    drawn = [statistic(values[rng.integers(len(values), size=len(values))])
             for _ in range(_RESAMPLES)]
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return float(low), float(high)


def _checked_level(level):
    if not 0 < level < 1:
        raise ParameterError(f'level must be between 0 and 1, got {level:g}')
    return level
