"""Detection in a whole recording: overlapping batches, one trajectory for each identity."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
import logging
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.options import DetectorOptions
from track_before_detect.timestamps import increasing_frames, median_interval, pieces
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.repeated_frames import RepeatedFrames
from track_before_detect.types import DetectionResult, FrameBatch, Progress, Step, Trajectory

_LOG = logging.getLogger(__name__)


class FrameSequence(Protocol):
    """What a recording has to offer; see the readers of the room ``recordings``."""

    @property
    def stamps(self) -> NDArray[np.float64]:
        """Seconds, shape (T,)."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def __getitem__(self, index: int) -> NDArray:
        """Return one frame, shape (H, W)."""


class BatchPipeline(Protocol):
    """What finds the trajectories of successive batches."""

    def process(self, batch: FrameBatch, progress: Progress | None = None) -> DetectionResult:
        """Find the trajectories of one batch, with the ids of the batches before."""


def batches(recording: FrameSequence, parts: Sequence[NDArray[np.int64]],
            stamps: NDArray[np.float64], length: int, hop: int,
            repeats: Callable[[NDArray], bool] = lambda frame: False) -> Iterator[FrameBatch]:
    """Yield the overlapping batches of a recording; the last of each part ends with its end.

    Parameters
    ----------
    recording : FrameSequence
        Read frame by frame, forwards; at most one batch is held.
    parts : sequence of array of int
        Numbers of the frames that are searched together.
    stamps : array, shape (T,)
        Seconds.
    length, hop : int
        Frames of a batch, and from one to the next.
    repeats : callable
        Told each frame, says whether it holds nothing new and is passed over.
    """
    for part in parts:
        held: deque[tuple[int, NDArray]] = deque(maxlen=length)
        n_new = 0
        for index in part.tolist():
            frame = np.asarray(recording[index])
            if repeats(frame):
                continue
            held.append((index, frame))
            n_new += 1
            if len(held) == length and n_new >= hop:
                n_new = 0
                yield _batch(held, stamps)
        if n_new:
            yield _batch(held, stamps)


def _batch(held: Iterable[tuple[int, NDArray]], stamps: NDArray[np.float64]) -> FrameBatch:
    indices = np.array([index for index, _ in held])
    return FrameBatch(np.stack([frame for _, frame in held]), stamps[indices], indices)


def detect_recording(recording: FrameSequence, options: DetectorOptions,
                     progress: Progress | None = None,
                     pipeline: BatchPipeline | None = None,
                     reasons: Sequence[str] = ()) -> DetectionResult:
    """Find all trajectories of a recording.

    Parameters
    ----------
    recording : FrameSequence
        Read frame by frame; at most one batch is held.
    options : DetectorOptions
        ``batch_length`` None takes the whole recording as one batch, ``hop`` None half a batch.
    progress : callable, optional
        Called with a label and the share done, 0 to 1.
    pipeline : BatchPipeline, optional
        Searches the batches; that of a single sensor unless given.
    reasons : sequence of str
        Why the options are these, the first remarks of the result.

    Returns
    -------
    DetectionResult
        One trajectory for each identity, its rows over all frames of the recording, NaN where
        it is absent; the threshold is the largest of any batch.
    """
    n_frames = len(recording)
    length = min(options.batch_length or n_frames, n_frames)
    hop = min(options.hop or max(1, length // 2), length)
    stamps = np.asarray(recording.stamps, float)
    repeated = RepeatedFrames()
    if pipeline is None:
        pipeline = TrackingPipeline(options)
        increasing = increasing_frames(stamps)
        if len(increasing) < min(2, n_frames):
            raise DataError(f'stamps must increase, got {n_frames} that do not')
        parts, remarks = pieces(stamps, length * median_interval(stamps[increasing]))
        cut = batches(recording, parts, stamps, length, hop, repeated.repeats)
    else:
        # Frames of several sensors may share a stamp, and follow one another as they come.
        remarks = []
        cut = batches(recording, [np.arange(n_frames)], stamps, length, hop)
    remarks = [*getattr(recording, 'remarks', []), *remarks]
    for remark in remarks:
        # Said before the search: it may fail for the same reason.
        _LOG.warning('%s', remark)
    joined = _Joined(stamps)
    history: list[Step] = []
    status, threshold, gap = 'converged', 0.0, float('nan')
    n_searched = 0
    searched: list[DetectionResult] = []
    for batch in cut:
        if not np.isfinite(batch.frames).any() and len(batch) < n_frames:
            # A gap in the recording ends no more than the trajectories that reach into it.
            _LOG.warning('frames %d to %d hold no finite pixel and are passed over',
                         batch.frame_indices[0], batch.frame_indices[-1])
            continue
        n_searched += 1
        result = pipeline.process(batch, progress)
        joined.add(result.trajectories)
        searched.append(result)
        history += result.history
        threshold = max(threshold, result.threshold)
        gap = float(np.fmax(gap, result.gap))
        if result.status != 'converged':
            status = result.status
        if progress is not None:
            progress('searching', (int(batch.frame_indices[-1]) + 1) / n_frames)
    if not n_searched:
        raise DataError(f'no pixel of the {n_frames} frames is finite')
    if isinstance(pipeline, TrackingPipeline):
        _carry_back(pipeline, searched, joined)
    if repeated.count:
        remarks.append(f'{repeated.count} of {n_frames} frames repeat the one before and are '
                       'passed over')
        _LOG.warning('%s', remarks[-1])
    return DetectionResult(joined.trajectories(), threshold, status, history, gap, n_searched,
                           [*reasons, *remarks],
                           [one for result in searched for one in result.rejected])


def _carry_back(pipeline: TrackingPipeline, searched: list[DetectionResult],
                joined: _Joined) -> None:
    """Follow trajectories back into the batches before the one that first found them."""
    later: list[Trajectory] = []
    for result in reversed(searched):
        seen = {trajectory.id for trajectory in result.trajectories}
        before = [carried for known in later if known.id not in seen
                  for carried in pipeline.carried_on(known, result.rejected)]
        joined.add(before)
        later = [*result.trajectories, *before]


class _Joined:
    """Trajectories over all frames, each frame from the batch that holds it deepest inside."""

    def __init__(self, stamps: NDArray[np.float64]):
        self._stamps = stamps
        self._parts: dict[int, list[Trajectory]] = {}

    def add(self, trajectories: list[Trajectory]) -> None:
        for trajectory in trajectories:
            self._parts.setdefault(trajectory.id, []).append(trajectory)

    def trajectories(self) -> list[Trajectory]:
        joined = [self._join(parts) for parts in self._parts.values()]
        return sorted(joined, key=lambda trajectory: -trajectory.statistic)

    def _join(self, parts: list[Trajectory]) -> Trajectory:
        n_frames = len(self._stamps)
        depth = np.full(n_frames, -1)
        positions = np.full((n_frames, 2), np.nan)
        velocity = np.full((n_frames, 2), np.nan)
        # Complex where those of a part are.
        amplitudes = np.full(n_frames, np.nan, np.result_type(*[p.amplitudes for p in parts]))
        for part in parts:
            own = np.arange(len(part.frame_indices))
            inside = np.minimum(own, own[::-1])
            better = inside > depth[part.frame_indices]
            rows = part.frame_indices[better]
            depth[rows] = inside[better]
            positions[rows] = part.positions[better]
            velocity[rows] = part.velocity[better]
            amplitudes[rows] = part.amplitudes[better]
        best = max(parts, key=lambda part: part.statistic)
        return Trajectory(best.id, positions, amplitudes, velocity, self._stamps,
                          np.arange(n_frames), best.statistic,
                          float(np.mean([part.snr for part in parts])))
