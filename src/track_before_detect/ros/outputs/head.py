"""Where targets are now: the last batch carried on to the newest frame. No ROS types in here."""

from dataclasses import dataclass, replace
from enum import IntEnum
import threading

import numpy as np
from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.ros.search_results import StreamResult
from track_before_detect.timestamps import median_interval
from track_before_detect.tracking.pipeline import period_of
from track_before_detect.types import Trajectory

# Frames at the end of a trajectory that say how fast its target is.
FRAMES_OF_END = 5
# Largest acceleration unless told: the speed of a pixel a frame is reached in so many frames.
FRAMES_TO_SPEED = 30
# Hops after the newest frame of a batch for which its targets are carried on; the next batch is
# ready within two where the search keeps up.
MOST_HOPS = 3


class State(IntEnum):
    """What is known of a target: one batch, more than one, or that the newest holds none."""

    TENTATIVE = 0
    CONFIRMED = 1
    ENDED = 2


@dataclass(frozen=True)
class HeadTarget:
    """One target at one moment.

    Attributes
    ----------
    id, state
        Of its trajectory, and what is known of it.
    stamp_s : float
    position, velocity : array, shape (2,)
        Seconds, pixels, pixels per second.
    covariance : array, shape (2, 2)
        Of the position, px^2; NaN where it is not known.
    amplitude, snr, statistic : float
        Of the trajectory, the amplitude where it was seen last.
    """

    id: int
    state: State
    stamp_s: float
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]
    amplitude: float
    snr: float
    statistic: float


@dataclass(frozen=True)
class _End:
    """A target where a batch saw it last, and how its covariance grows from there.

    ``growth`` (3, 2, 2) are the coefficients of a polynomial in the time since, the lowest first.
    """

    target: HeadTarget
    growth: NDArray[np.float64]

    def at(self, stamp_s: float, acceleration: float) -> HeadTarget:
        """Return the target a little later, for accelerations up to one in px/s^2."""
        target, later = self.target, stamp_s - self.target.stamp_s
        covariance = np.tensordot(later**np.arange(3.0), self.growth, 1)
        if not np.all(np.diag(covariance) >= np.diag(target.covariance)):
            covariance = target.covariance
        # Any acceleration up to the largest is as likely.
        bent = (acceleration * later**2 / 2)**2 / 3
        return replace(target, stamp_s=stamp_s,
                       position=target.position + later * target.velocity,
                       covariance=covariance + bent * np.eye(2))


class Head:
    """Carries the targets of the last batch on, and has them corrected by the next.

    Batches are told in the thread of the search, and moments asked for in another.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._batches: dict[int, int] = {}
        self._ends: list[_End] = []
        self._ended: list[HeadTarget] = []
        self._until_s = self._newest_s = -np.inf
        self._acceleration = 0.0
        self._period: int | None = None

    def update(self, result: StreamResult, options: DetectorOptions) -> None:
        """Take what was found in a batch."""
        batch = result.batch
        period = period_of(options, batch.frames.shape[2])
        # Those that left before the end of the batch are no more.
        found = [one for one in result.detection.trajectories
                 if len(one.stamps) and np.isfinite(one.positions[-1]).all()]
        interval = median_interval(batch.stamps)
        acceleration = options.max_acceleration_px_s2
        with self._lock:
            before = {end.target.id: end.target for end in self._ends}
            self._batches = {one.id: self._batches.get(one.id, 0) + 1 for one in found}
            self._ends = [_end(one, State(min(self._batches[one.id], 2) - 1), period)
                          for one in found]
            self._ended += [replace(target, state=State.ENDED) for number, target in before.items()
                            if number not in self._batches]
            self._until_s = float(batch.stamps[-1]) + MOST_HOPS * result.hop * result.interval_s
            self._acceleration = (1 / (FRAMES_TO_SPEED * interval**2) if acceleration is None
                                  else acceleration)
            self._period = period

    def clear(self) -> None:
        """End all targets: another stream begins."""
        with self._lock:
            self._ended += [replace(end.target, state=State.ENDED) for end in self._ends]
            self._batches, self._ends, self._newest_s = {}, [], -np.inf

    def at(self, stamp_s: float) -> list[HeadTarget] | None:
        """Return the targets at a moment, those that have ended since the last one once.

        None where the moment lies before one that was asked for.
        """
        with self._lock:
            if stamp_s <= self._newest_s:
                return None
            self._newest_s = stamp_s
            ended, self._ended = self._ended, []
            if stamp_s > self._until_s:
                # The search is behind or has stopped.
                return ended
            targets = [end.at(stamp_s, self._acceleration) for end in self._ends]
            period = self._period
        for target in targets:
            if period is not None:
                target.position[0] %= period
        return targets + ended


def _end(trajectory: Trajectory, state: State, period: int | None) -> _End:
    present = np.isfinite(trajectory.positions).all(axis=1)
    times = trajectory.stamps[present] - trajectory.stamps[-1]
    positions = trajectory.positions[present].copy()
    if period is not None:
        positions[:, 0] = np.unwrap(positions[:, 0], period=period)
    velocity = np.zeros(2)
    last = slice(-FRAMES_OF_END, None)
    if np.ptp(times[last]):
        velocity = np.polyfit(times[last], positions[last], 1)[0]
    # The variance of a motion is a square in time where it is a line, and little else otherwise.
    covariance = trajectory.covariance[present]
    growth = np.zeros((3, 2, 2))
    growth[0] = covariance[-1]
    if len(np.unique(times)) > 2 and np.isfinite(covariance).all():
        fitted = np.polyfit(times, covariance.reshape(-1, 4), 2)[::-1].reshape(3, 2, 2)
        growth[1:] = fitted[1:]
    return _End(HeadTarget(
        trajectory.id, state, float(trajectory.stamps[-1]), positions[-1], velocity,
        covariance[-1], float(abs(trajectory.amplitudes[-1])), trajectory.snr,
        trajectory.statistic), growth)
