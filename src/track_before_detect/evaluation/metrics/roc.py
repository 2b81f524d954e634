"""Detections against false alarms while the threshold varies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.confidence import poisson_interval, wilson_interval


@dataclass(frozen=True)
class Roc:
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

    Returns
    -------
    Roc
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
    detected, alarms, alarmed = (
        len(values) - np.searchsorted(np.sort(values), thresholds)
        for values in (targets, false, largest))
    return Roc(
        thresholds,
        _with_intervals(detected, lambda n: (n / len(targets),
                                             *wilson_interval(n, len(targets)))),
        _with_intervals(alarms, lambda n: (n / len(batches),
                                           *poisson_interval(n, len(batches)))),
        _with_intervals(alarmed, lambda n: (n / len(batches),
                                            *wilson_interval(n, len(batches)))))


def _with_intervals(counts, estimate):
    return np.array([estimate(int(count)) for count in counts]).reshape(-1, 3)
