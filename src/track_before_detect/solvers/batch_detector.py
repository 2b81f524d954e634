"""What every detector of one batch offers: a threshold and a result."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.capabilities import check_options
from track_before_detect.checks import check_kind
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.calibration.threshold import (
    CACHED,
    calibrate,
    Calibration,
    MODEL,
    SIMULATED,
)
from track_before_detect.timestamps import median_interval
from track_before_detect.types import FrameBatch, Progress, Step

_LOG = logging.getLogger(__name__)
# What is said of a threshold, by its source.
_SOURCES = {MODEL: 'by the model of noise; tbd calibrate searches noise',
            CACHED: 'by noise that was searched before', SIMULATED: 'by a search of noise'}
# Relative difference of frame intervals that share a calibration.
SAME_INTERVAL = 0.2
# Largest speed in clutter unless told, px a frame.
FAST_PX = 5.0


@dataclass(frozen=True)
class FoundTrajectory:
    """One target in one batch.

    Attributes
    ----------
    positions : array, shape (T, 2)
        x and y in pixels of the prepared frames; NaN where the target is absent.
    amplitudes : array, shape (T,)
        Of the unit-norm PSF, in units of the noise standard deviation (of that at a weight of one
        where the detector weighs pixels); NaN where it is absent.
    statistic : float
        What is compared with the threshold.
    snr : float
        Mean of the statistic of one frame over those in which the target is present.
    reason : str
        Why it is rejected; empty for a target.
    covariance : array, shape (T, 2, 2), or None
        Of the positions, NaN where it is absent; None where the detector does not know it.
    """

    positions: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    statistic: float
    snr: float
    reason: str = ''
    covariance: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class EarlierPaths:
    """Targets that were seen in frames which the next batch holds again.

    Attributes
    ----------
    positions : list of array, shape (T, 2)
        x and y of each in pixels of the prepared frames of the next batch, the strongest first;
        NaN where the target was absent or the frame is new.
    known : array of bool, shape (T,)
        Which frames are not new.
    """

    positions: list[NDArray[np.float64]]
    known: NDArray[np.bool_]


@dataclass(frozen=True)
class BatchResult:
    """What was found in one batch; fields as in DetectionResult."""

    found: list[FoundTrajectory]
    threshold: float
    status: str
    history: list[Step]
    gap: float = float('nan')
    best_statistic: float = float('nan')
    rejected: list[FoundTrajectory] = field(default_factory=list)


def share_threshold(interval: float, calibrated: float) -> bool:
    """Return whether batches of a frame interval take the threshold that another one has."""
    return abs(interval / calibrated - 1) <= SAME_INTERVAL


class BatchDetector(ABC):
    """Finds the trajectories of one batch of prepared frames.

    Parameters
    ----------
    options : DetectorOptions
        What to look for, and the threshold or the rate it follows from.

    Raises
    ------
    ParameterError
        An option asks for what this detector cannot do.

    Attributes
    ----------
    threshold_source : str
        Where the last threshold comes from: given, model, cached or simulated (see
        ``solvers.calibration.threshold``), or batch; empty before there is one.
    """

    def __init__(self, options: DetectorOptions):
        check_options(options)
        self.options = options
        # Thresholds for numbers of frames and shapes, each with the frame interval it is for.
        self._thresholds: dict[tuple, list[tuple[float, Calibration]]] = {}
        self.threshold_source = ''

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return the threshold for batches of this shape, calibrating it where it is unknown."""
        if self.options.threshold is not None:
            self.threshold_source = 'given'
            return self.options.threshold
        # Lost frames, jitter and a drifting clock change the threshold by a few hundredths; a
        # calibration for each pattern would stop a stream for half a minute at every lost frame.
        interval = median_interval(stamps)
        known = self._thresholds.setdefault((len(stamps), shape), [])
        for calibrated_interval, calibration in known:
            if share_threshold(interval, calibrated_interval):
                self.threshold_source = calibration.source
                return calibration.threshold
        study = self.noise_study(interval * np.arange(len(stamps)), shape)
        calibration = self.calibrated(study, shape, progress)
        known.append((interval, calibration))
        return calibration.threshold

    def calibrated(self, study: NoiseStudy, shape: tuple[int, int],
                   progress: Progress | None) -> Calibration:
        """Return the threshold that the false alarm rate asks for, and say where it is from."""
        rate = self.options.false_alarm_rate
        calibration = calibrate(study, shape, rate, progress)
        self.threshold_source = calibration.source
        _LOG.info('the threshold of %.4g for a false alarm rate of %.3g is known %s',
                  calibration.threshold, rate, _SOURCES[calibration.source])
        return calibration

    def parts(self) -> Sequence[BatchDetector]:
        """Return the detectors that have a threshold each, which a batch is searched with."""
        return [self]

    def check_kind(self, frames: NDArray) -> None:
        """Refuse complex frames for real amplitudes, and real ones for complex amplitudes."""
        check_kind(frames, self.options.amplitudes)

    @abstractmethod
    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic in noise.

        Parameters
        ----------
        stamps : array, shape (T,)
            Seconds, at equal intervals.
        shape : tuple of int
            (H, W) of the frames.
        """

    @abstractmethod
    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories.

        Parameters
        ----------
        batch : FrameBatch
            Frames of unit noise, float32 or complex64; NaN where masked.
        weights : float32 array, shape (T, H, W) or (1, H, W), optional
            One over the noise that each pixel had before it was scaled to one, zero where masked;
            all the same unless given.
        earlier : EarlierPaths, optional
            Where targets of the batch before are in this one; a detector that begins afresh takes
            no notice.
        progress : callable, optional
            Told of a calibration, and of the search while it lasts.
        """


def max_speed(options: DetectorOptions, stamps: NDArray) -> float:
    """Return the largest speed that the options ask for in frames taken at ``stamps``, px/s."""
    if options.motion_model == 'static' or len(stamps) == 1:
        return 0.0
    speed = options.max_speed_px_s
    return 1.0 / median_interval(stamps) if speed is None else speed


def searched_speed(options: DetectorOptions, stamps: NDArray, shape: tuple[int, int]) -> float:
    """Return the largest speed that can be seen in frames (H, W), px/s.

    A target that crosses the frame in one interval is as fast as can be seen, and the turns that
    come with a larger speed would take for ever to search. In clutter, where targets are bright
    and cameras shake, the largest speed unless told is that of crossing a third of the frame
    during the batch, and at most ``FAST_PX`` px a frame.
    """
    if options.calibration == 'clutter' and options.max_speed_px_s is None and len(stamps) > 1:
        fast = min(FAST_PX, min(shape) / (3 * len(stamps)))
        return max(fast, 1.0) / median_interval(stamps)
    return min(max_speed(options, stamps), float(np.hypot(*shape)) / median_interval(stamps))
