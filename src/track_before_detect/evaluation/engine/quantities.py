"""What a study estimates, with the interval it is known to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.evaluation.metrics.confidence import (
    bootstrap_interval,
    Statistic,
    wilson_interval,
)


@dataclass(frozen=True)
class Quantity:
    """One line of a report.

    Attributes
    ----------
    name : str
        What was estimated.
    value : float
        The estimate; NaN when there was nothing to estimate it from.
    low, high : float
        Ends of its 95 % interval.
    trials : int
        How many of what it was estimated from.
    per : str
        What was counted in ``trials``: runs, targets, batches.
    unit : str
        Unit of the value; ``%`` shows a share as per cent.
    note : str
        What to compare it with.
    """

    name: str
    value: float
    low: float
    high: float
    trials: int
    per: str
    unit: str = ''
    note: str = ''


def share(name: str, count: int, trials: int, per: str, note: str = '') -> Quantity:
    """Return a share, so many of so many, with its Wilson interval."""
    return Quantity(name, count / trials, *wilson_interval(count, trials), trials, per, '%', note)


def estimate(name: str, samples: ArrayLike, statistic: Statistic, per: str, unit: str = '',
             note: str = '', trials: int | None = None) -> Quantity:
    """Return a statistic of independent runs with its bootstrap interval.

    Parameters
    ----------
    name, per, unit, note
        As of a quantity.
    samples : array, shape (N, ...)
        One entry per run.
    statistic : callable
        Told an array of the same shape, returns a number.
    trials : int, optional
        What the samples were made of; the number of samples unless given.
    """
    values = np.asarray(samples)
    return Quantity(name, statistic(values), *bootstrap_interval(values, statistic),
                    trials or len(values), per, unit, note)


def mean(name: str, samples: ArrayLike, per: str, unit: str = '', note: str = '',
         trials: int | None = None) -> Quantity:
    """Return the mean over independent runs; arguments as of :func:`estimate`."""
    return estimate(name, samples, mean_of, per, unit, note, trials)


def mean_of(samples: NDArray) -> float:
    """Return the mean of all numbers."""
    return float(samples.mean())
