"""What is said of one batch that was searched."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.preprocess.prepare import PreparedBatch
from track_before_detect.preprocess.robust import robust_deviation
from track_before_detect.preprocess.whiteness import autocorrelation
from track_before_detect.solvers.batch_detector import BatchResult

# Shifts that whiteness is looked at over, in pixels and in frames.
MOST_LAGS = 8
# Pixels of a batch that whiteness and spread are measured from, about.
N_SAMPLES = 500_000


@dataclass(frozen=True)
class BatchFacts:
    """One batch beside one background.

    Attributes
    ----------
    frames : array of int
        Numbers of its frames in the recording.
    strongest : float
        Largest statistic of any path over its threshold.
    level : float
        Median level of the noise, in units of the input.
    spread, middle : float
        Robust deviation of what is searched, which should be one, and median, which should be 0.
    in_space, in_time : array
        Autocorrelation of what is searched over pixels and over frames.
    no_data : float
        Share of the pixels searched that are masked or that the moving camera does not show.
    """

    frames: NDArray[np.int64]
    strongest: float
    level: float
    spread: float
    middle: float
    in_space: NDArray[np.float64]
    in_time: NDArray[np.float64]
    no_data: float


def strongest(result: BatchResult) -> float:
    """Return the largest statistic of any path of a batch over the threshold; NaN without one."""
    statistics = [one.statistic / result.threshold for one in (*result.found, *result.rejected)]
    on_residual = [1 + step.violation for step in result.history if np.isfinite(step.violation)]
    return max([*statistics, *on_residual], default=float('nan'))


def facts_of(prepared: PreparedBatch, result: BatchResult) -> BatchFacts:
    """Return the facts of a batch that was searched."""
    frames = prepared.frames
    few = frames[::max(1, round(frames.size / N_SAMPLES))]
    step = max(1, round((frames.size / N_SAMPLES) ** 0.5))
    finite = few[np.isfinite(few)]
    parts = np.concatenate([finite.real, finite.imag]) * 2**0.5 if np.iscomplexobj(
        finite) else finite
    levels = prepared.noise_level[np.isfinite(prepared.noise_level)]
    across = [autocorrelation(few, axis, MOST_LAGS) for axis in (1, 2)]
    shared = min(map(len, across))
    return BatchFacts(
        prepared.frame_indices, strongest(result),
        float(np.median(levels)) if len(levels) else float('nan'), robust_deviation(parts),
        float(np.median(parts)) if len(parts) else float('nan'),
        np.mean([one[:shared] for one in across], axis=0),
        autocorrelation(frames[:, ::step, ::step], 0, MOST_LAGS),
        1 - len(finite) / max(few.size, 1))
