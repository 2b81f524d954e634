"""Detections against false alarms while the threshold varies."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.confidence import poisson_interval, wilson_interval


class Roc(NamedTuple):
    """Receiver operating characteristic, by descending threshold.

    Attributes
    ----------
    thresholds : array, shape (K,)
        Each statistic that occurs; what is at least this large counts.
    detection_probability : array, shape (K, 3)
        Share of targets detected, and the ends of its 95 % interval (Wilson).
    false_alarms_per_batch : array, shape (K, 3)
        Mean number of false trajectories in a batch, and the ends of its 95 % interval (Poisson).
    alarmed_batches : array, shape (K, 3)
        Share of batches with a false trajectory, and the ends of its 95 % interval (Wilson).
    """

    thresholds: NDArray[np.float64]
    detection_probability: NDArray[np.float64]
    false_alarms_per_batch: NDArray[np.float64]
    alarmed_batches: NDArray[np.float64]


def roc(of_targets: ArrayLike, of_false: Sequence[ArrayLike]) -> Roc:
    """Return detections and false alarms at every threshold that makes a difference.

    Parameters
    ----------
    of_targets : array, shape (M,)
        Largest statistic of a trajectory of each target; NaN or -inf for a target without one.
    of_false : sequence of array
        Statistics of the false trajectories of each batch, in any number.
    """
    targets = np.nan_to_num(np.asarray(of_targets, float), nan=-np.inf)
    batches = [np.asarray(batch, float).ravel() for batch in of_false]
    if not len(targets) or not batches:
        raise ParameterError(
            f'of_targets and of_false must not be empty, got {len(targets)} targets and '
            f'{len(batches)} batches')
    false = np.concatenate(batches)
    largest = np.array([batch.max(initial=-np.inf) for batch in batches])
    thresholds = np.unique(np.concatenate([targets[np.isfinite(targets)], false]))[::-1]

    def rate(statistics: NDArray, trials: int,
             interval: Callable[[int, int], tuple[float, float]]) -> NDArray[np.float64]:
        """Return how many reach each threshold, per trial, with its interval."""
        counts = len(statistics) - np.searchsorted(np.sort(statistics), thresholds)
        ends = {count: interval(count, trials) for count in set(counts.tolist())}
        return np.array([(count / trials, *ends[count]) for count in counts.tolist()]
                        ).reshape(-1, 3)

    return Roc(thresholds, rate(targets, len(targets), wilson_interval),
               rate(false, len(batches), poisson_interval),
               rate(largest, len(batches), wilson_interval))
