"""What travels between the rooms of the package: batches of frames, trajectories, results."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

# Called during long work with what is being done and the share that is done, 0 to 1.
Progress = Callable[[str, float], None]


class Count(float):
    """A share that is done, and in words how many of how many."""

    def __new__(cls, share: float, words: str) -> Count:
        """Return the share with its words."""
        count = super().__new__(cls, share)
        count.words = words
        return count

    words: str

    def __str__(self) -> str:
        return self.words


def within(progress: Progress, begun: float, ended: float) -> Progress:
    """Return what tells of a search that is a part of a longer one.

    Parameters
    ----------
    progress : callable
        Told of the longer one.
    begun, ended : float
        Shares of it that are done before the part and after.
    """

    def tell(label: str, done: float) -> None:
        if label == 'searching':
            done = begun + done * (ended - begun)
        progress(label, done)

    return tell


# Trajectories of a result that are printed, the best first.
SHOWN_TRAJECTORIES = 10

# How a search may end, and what that means; the later ones leave more to be wished.
STATUSES = {
    'converged': 'no path is left that passes the threshold',
    'iteration_limit': 'left before its end, after the most trajectories or rounds that the '
                       'detector takes: more may be there, and some may be false',
    'time_limit': 'left when max_time_s was up: more may be there, and some may be false',
    'not_noise': 'not searched: the frames pass the threshold nearly everywhere, as noise never '
                 'does',
}


def worst_status(statuses: Iterable[str]) -> str:
    """Return the one of some statuses that is furthest down in :data:`STATUSES`."""
    return max(statuses, key=list(STATUSES).index)


@dataclass(frozen=True)
class FrameBatch:
    """The frames that are searched together.

    Attributes
    ----------
    frames : array, shape (T, H, W)
        Pixel values, real or complex; a pixel that is not finite counts as masked.
    stamps : array, shape (T,)
        Time of each frame in seconds, strictly increasing.
    frame_indices : array of int, shape (T,)
        Number of each frame in its recording or stream, strictly increasing.
    scene : array, shape (T, 3, 3), optional
        Takes the pixels of one of the frames to where each shows the same of a moving scene, see
        the module ``geometry``.
    taken : array of int, shape (T, 2), optional
        Where they come from several sensors: the number of the sensor that took each frame, and
        of the frame among its own.
    part_of : tuple of int, optional
        (H, W) of the frames of which these are a tile; the threshold is theirs.
    """

    frames: NDArray
    stamps: NDArray[np.float64]
    frame_indices: NDArray[np.int64]
    scene: NDArray[np.float64] | None = None
    taken: NDArray[np.int64] | None = None
    part_of: tuple[int, int] | None = None

    @classmethod
    def of(cls, frames: NDArray, stamps: NDArray | None = None) -> FrameBatch:
        """Return the batch of a recording that it is all of; stamps 1 s apart unless given."""
        numbers = np.arange(len(frames))
        return cls(frames, numbers.astype(float) if stamps is None else stamps, numbers)

    def __len__(self) -> int:
        return len(self.frames)


@dataclass(frozen=True)
class Remark:
    """What was done with pixels or frames of a batch that could not be searched as they came.

    Attributes
    ----------
    kind : str
        What it is about; said once, or once for each frame.
    text : str
        A sentence, ``{frames}`` where frames are named.
    frames : tuple of int
        Numbers of these frames in the recording, ascending; none where it is about pixels.
    """

    kind: str
    text: str
    frames: tuple[int, ...] = ()


@dataclass(frozen=True)
class Trajectory:
    """One detected target.

    Rows belong to the frames named by ``frame_indices``; where the target is absent the row is
    NaN.

    Attributes
    ----------
    id : int
        Identity, kept over all batches of a recording or stream.
    positions : array, shape (T, 2)
        Column x and row y in pixels of the original frames; pixel centres are integers.
    amplitudes : array, shape (T,)
        Amplitude of the unit-norm point spread function, in the units of the input. In frames that
        hold no data where the target is, that of ``convex`` and ``greedy`` is NaN.
    velocity : array, shape (T, 2)
        Pixels per second.
    stamps : array, shape (T,)
        Seconds.
    frame_indices : array of int, shape (T,)
        Number of each frame in the recording.
    statistic : float
        What is compared with the threshold; above it for a reported trajectory, but for one
        that carries on a trajectory of the batch beside it (``calibration=clutter``).
    snr : float
        Mean over frames of the matched filter statistic, which has unit variance in noise: the
        signal-to-noise ratio in one frame. ``convex`` and ``greedy`` leave out the frames that
        hold no data where the target is.
    reason : str
        Why it is rejected; empty for a target.
    covariance : array, shape (T, 2, 2)
        Of the errors of x and y in px^2, where noise is all that disturbs the frames; NaN where
        the target is absent, and of detectors that do not look for positions between the pixels
        (all but ``convex`` and ``calibration=clutter``).
    """

    id: int
    positions: NDArray[np.float64]
    amplitudes: NDArray
    velocity: NDArray[np.float64]
    stamps: NDArray[np.float64]
    frame_indices: NDArray[np.int64]
    statistic: float
    snr: float
    reason: str = ''
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2, 2)))

    def __post_init__(self) -> None:
        if not len(self.covariance):
            unknown = np.full((len(self.positions), 2, 2), np.nan)
            object.__setattr__(self, 'covariance', unknown)

    def __repr__(self) -> str:
        present = np.isfinite(self.positions).all(axis=1)
        if not present.any():
            return f'Trajectory(id={self.id}, never present)'
        frames, places = self.frame_indices[present], self.positions[present]
        speeds = np.hypot(*self.velocity[present].T)
        speeds = speeds[np.isfinite(speeds)]
        moving = f', {speeds.mean():.2f} px/s' if len(speeds) else ''
        return (f'Trajectory(id={self.id}, frames {frames[0]}-{frames[-1]}, '
                f'({places[0, 0]:.1f}, {places[0, 1]:.1f}) to '
                f'({places[-1, 0]:.1f}, {places[-1, 1]:.1f}) px{moving}, snr={self.snr:.2f}, '
                f'statistic={self.statistic:.2f})')


@dataclass(frozen=True)
class Step:
    """One step of a solver.

    Attributes
    ----------
    t : float
        Place on the continuation: 1 is the convex objective, 0 the combinatorial one.
    objective : float
        Value of F_t after the step; NaN of methods without one.
    n_paths : int
        Number of paths with non-zero amplitude.
    violation : float
        Largest statistic of any path on the residual over the threshold, less one; at most the
        tolerance when the step ended a stage. NaN of steps that do not search, as in the stages
        between the first and the last.
    """

    t: float
    objective: float
    n_paths: int
    violation: float


@dataclass(frozen=True)
class DetectionResult:
    """What a detector found.

    Attributes
    ----------
    trajectories : list of Trajectory
        One per target, by descending statistic.
    threshold : float
        Value the statistic of a trajectory had to pass.
    status : str
        One of ``types.STATUSES``; over several batches the one that is furthest down there.
    history : list of Step
        Progress of the solver, batch after batch.
    gap : float
        Duality gap of the convex stage (t = 1), absolute; the largest of all batches; NaN when no
        such stage was run.
    best_statistic : float
        Largest statistic of any path that is not among the trajectories, on what these leave of
        the frames, by the last search: how far below the threshold the next one is. The largest
        of all batches; NaN where the detector does not know it.
    n_batches : int
        Batches that were searched.
    remarks : list of str
        What was done with frames that could not be searched as they came, and what to set where
        they are not the noise that the options say, a sentence each.
    rejected : list of Trajectory
        Candidates that are no target, each with its ``reason``, where the detector looks for
        reasons (``calibration=clutter``): id 0.
    threshold_source : str
        Where the threshold comes from: ``given``, ``model`` of noise, ``simulated`` noise,
        ``cached`` where it was simulated before, the ``batch`` itself (``calibration=clutter``);
        several where batches or amplitude models differ. Empty where nothing was searched.
    """

    trajectories: list[Trajectory]
    threshold: float
    status: str = 'converged'
    history: list[Step] = field(default_factory=list)
    gap: float = float('nan')
    best_statistic: float = float('nan')
    n_batches: int = 1
    remarks: list[str] = field(default_factory=list)
    rejected: list[Trajectory] = field(default_factory=list)
    threshold_source: str = ''

    def __repr__(self) -> str:
        head = (f'DetectionResult({len(self.trajectories)} trajectories, '
                f'threshold={self.threshold:.2f}, status={self.status!r}, '
                f'n_batches={self.n_batches}, {len(self.history)} steps, '
                f'{len(self.remarks)} remarks)')
        more = len(self.trajectories) - SHOWN_TRAJECTORIES
        return '\n'.join([head, *(f'  {trajectory!r}' for trajectory
                                  in self.trajectories[:SHOWN_TRAJECTORIES]),
                          *([f'  and {more} more'] if more > 0 else [])])
