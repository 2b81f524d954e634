"""Detection in a whole recording: overlapping batches, one trajectory for each identity."""

from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from itertools import chain
import logging
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import ahead
from track_before_detect.solvers.batch_detector import share_threshold
from track_before_detect.timestamps import increasing_frames, median_interval, pieces
from track_before_detect.tracking.batcher import hop_of
from track_before_detect.tracking.joined import JoinedTrajectories
from track_before_detect.tracking.pipeline import (
    BatchSearch,
    Observer,
    TrackingPipeline,
    Unlinked,
)
from track_before_detect.tracking.repeated_frames import RepeatedFrames
from track_before_detect.tracking.stitcher import not_carried
from track_before_detect.types import DetectionResult, FrameBatch, Progress, within, worst_status

_LOG = logging.getLogger(__name__)
_Item = TypeVar('_Item')
_Search = TypeVar('_Search')
# Batches after which the search begins afresh, so that others may search what follows.
SPAN = 8


class FrameSequence(Protocol):
    """What a recording has to offer; see the readers of the room ``recordings``."""

    @property
    def stamps(self) -> NDArray[np.float64]:
        """Seconds, shape (T,)."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def __getitem__(self, index: int) -> NDArray:
        """Return one frame, shape (H, W)."""


class Span(NamedTuple):
    """Batches that are searched apart from those before.

    Attributes
    ----------
    batches : list of array of int
        Numbers of the frames of each.
    earlier : list of array of int
        Those of the batches before whose thresholds are not those of others, in their order.
    """

    batches: list[NDArray[np.int64]]
    earlier: list[NDArray[np.int64]]


class SharedSearch(Protocol):
    """Whoever searches the spans of a recording at the same time; see ``spans/``."""

    def changes(self, order: NDArray[np.int64], progress: Progress | None) -> Iterable[float]:
        """Return how much changes from each of some frames to the next."""

    def found(self, spans: Sequence[Span],
              progress: Progress | None) -> Iterable[Sequence[Unlinked | None]]:
        """Return what is in each batch of each span in their order, None in those passed over."""


class BatchPipeline(Protocol):
    """What finds the trajectories of successive batches.

    Attributes
    ----------
    stamps_may_repeat : bool
        Whether frames may share a stamp, and are neither out of order nor repeated then: those of
        several sensors, which follow one another as they come.
    """

    stamps_may_repeat: bool

    def prepare(self, batch: FrameBatch, progress: Progress | None = None) -> BatchSearch:
        """Prepare a batch; return what finds its trajectories, with the ids of those before."""


def batches(recording: FrameSequence, parts: Sequence[NDArray[np.int64]],
            stamps: NDArray[np.float64], length: int, hop: int,
            repeats: Callable[[NDArray], bool] = lambda frame: False,
            taken: NDArray[np.int64] | None = None) -> Iterator[FrameBatch]:
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
    taken : array of int, shape (T, 2), optional
        Which of several sensors took each frame, see :class:`FrameBatch`.
    """
    def new_frames(part: NDArray[np.int64]) -> Iterator[tuple[int, NDArray]]:
        for index in part.tolist():
            frame = np.asarray(recording[index])
            if not repeats(frame):
                yield index, frame

    for held in _cut(map(new_frames, parts), length, hop):
        yield _batch(held, stamps, taken)


def frames_of_batches(parts: Sequence[NDArray[np.int64]], repeated: Collection[int],
                      length: int, hop: int) -> list[NDArray[np.int64]]:
    """Return the numbers of the frames of each of the :func:`batches`, told which repeat."""
    return [np.array(held) for held in _cut(
        ([index for index in part.tolist() if index not in repeated] for part in parts),
        length, hop)]


def spans_of(batches: Sequence[NDArray[np.int64]], stamps: NDArray[np.float64]) -> list[Span]:
    """Return the spans of batches, told the numbers of the frames of each."""
    spans: list[Span] = []
    earlier: list[tuple[NDArray[np.int64], float]] = []
    for first in range(0, len(batches), SPAN):
        own = list(batches[first:first + SPAN])
        spans.append(Span(own, [one for one, _ in earlier]))
        for one in own:
            interval = median_interval(stamps[one])
            if not any(len(one) == len(other) and share_threshold(interval, calibrated)
                       for other, calibrated in earlier):
                earlier.append((one, interval))
    return spans


def _cut(parts: Iterable[Iterable[_Item]], length: int, hop: int) -> Iterator[Collection[_Item]]:
    """Yield what is in each batch; it changes when the next one is asked for."""
    for part in parts:
        held: deque[_Item] = deque(maxlen=length)
        n_new = 0
        for item in part:
            held.append(item)
            n_new += 1
            if len(held) == length and n_new >= hop:
                n_new = 0
                yield held
        if n_new:
            yield held


def length_and_hop(n_frames: int, options: DetectorOptions) -> tuple[int, int]:
    """Return the frames of a batch of a recording, and from one batch to the next."""
    length = min(options.batch_length or n_frames, n_frames)
    return length, min(options.hop or hop_of(length), length)


def parts_of(stamps: NDArray[np.float64],
             length: int) -> tuple[list[NDArray[np.int64]], list[str]]:
    """Return the numbers of the frames between pauses, and what there is to say of the stamps."""
    increasing = increasing_frames(stamps)
    if len(increasing) < min(2, len(stamps)):
        raise DataError(f'stamps must increase, got {len(stamps)} that do not')
    return pieces(stamps, length * median_interval(stamps[increasing]))


def _batch(held: Collection[tuple[int, NDArray]], stamps: NDArray[np.float64],
           taken: NDArray[np.int64] | None) -> FrameBatch:
    indices = np.array([index for index, _ in held])
    return FrameBatch(np.stack([frame for _, frame in held]), stamps[indices], indices,
                      taken=None if taken is None else taken[indices])


def detect_recording(recording: FrameSequence, options: DetectorOptions,
                     progress: Progress | None = None,
                     pipeline: BatchPipeline | None = None,
                     observe: Observer | None = None,
                     reasons: Sequence[str] = (),
                     shared: SharedSearch | None = None,
                     over_all_frames: bool = True) -> DetectionResult:
    """Find all trajectories of a recording.

    Parameters
    ----------
    recording : FrameSequence
        Read frame by frame, in another thread while the batch before is searched.
    options : DetectorOptions
        ``batch_length`` None takes the whole recording as one batch, ``hop`` None half a batch.
    progress : callable, optional
        Called with a label and the share done, 0 to 1.
    pipeline : BatchPipeline, optional
        Searches the batches; that of a single sensor unless given.
    observe : callable, optional
        Shown each batch of a single sensor, as :class:`TrackingPipeline` does.
    reasons : sequence of str
        Why the options are these, the first remarks of the result.
    shared : SharedSearch, optional
        Searches the batches in place of this process, those of a single sensor.
    over_all_frames : bool
        Whether a trajectory has rows for all frames of the recording, or from the first to the
        last frame of the batches that found it: much less memory where many are found in a long
        one.

    Returns
    -------
    DetectionResult
        One trajectory for each identity, its rows over all frames of the recording unless told
        otherwise, NaN where it is absent; the threshold is the largest of any batch.
    """
    n_frames = len(recording)
    length, hop = length_and_hop(n_frames, options)
    stamps = np.asarray(recording.stamps, float)
    repeated = RepeatedFrames()
    pipeline = pipeline or TrackingPipeline(options, observe=observe)
    if not pipeline.stamps_may_repeat:
        parts, remarks = parts_of(stamps, length)
        cut = batches(recording, parts, stamps, length, hop, repeated.repeats)
    else:
        remarks = []
        cut = batches(recording, [np.arange(n_frames)], stamps, length, hop,
                      taken=getattr(recording, 'taken', None))
    remarks = [*getattr(recording, 'remarks', []), *remarks]
    for remark in remarks:
        # Said before the search: it may fail for the same reason.
        _LOG.warning('%s', remark)
    joined = JoinedTrajectories(stamps, psf_of(options).width_px)
    searched: list[tuple[NDArray[np.int64], DetectionResult]] = []
    if progress is not None:
        progress('searching', 0.0)
    with closing(_searched(cut, pipeline, n_frames, progress) if shared is None else _linked(
            shared, parts, stamps, length, hop, repeated, TrackingPipeline(options),
            progress)) as results_of:
        for frame_indices, result in results_of:
            searched.append((frame_indices, result))
            remarks += result.remarks
    if not searched:
        raise DataError(f'no pixel of the {n_frames} frames is finite')
    if repeated.count:
        remarks.append(f'{repeated.count} of {n_frames} frames repeat the one before and are '
                       'passed over')
        _LOG.warning('%s', remarks[-1])
    results = [result for _, result in searched]
    if isinstance(pipeline, TrackingPipeline):
        _carry_back(pipeline, results)
    for frame_indices, result in searched:
        joined.add(frame_indices, result.trajectories)
    return DetectionResult(
        joined.trajectories(over_all_frames), max(result.threshold for result in results),
        worst_status(result.status for result in results),
        [step for result in results for step in result.history],
        float(np.fmax.reduce([result.gap for result in results])),
        float(np.fmax.reduce([result.best_statistic for result in results])), len(results),
        [*reasons, *remarks],
        [one for result in results for one in not_carried(result.rejected, result.trajectories)],
        ', '.join(dict.fromkeys(result.threshold_source for result in results
                                if result.threshold_source)))


def _searched(cut: Iterable[FrameBatch], pipeline: BatchPipeline, n_frames: int,
              progress: Progress | None,
              ) -> Generator[tuple[NDArray[np.int64], DetectionResult]]:
    """Yield the frame numbers of each batch that shows anything, and what is found there."""
    n_done, span = 0, 0
    with closing(ahead(prepared_batches(cut, pipeline.prepare, n_frames, progress))) as prepared:
        for number, frame_indices, search in prepared:
            if number // SPAN > span and isinstance(pipeline, TrackingPipeline):
                span = number // SPAN
                pipeline.begin_afresh()
            n_until = int(frame_indices[-1]) + 1
            result = search(
                progress and within(progress, n_done / n_frames, n_until / n_frames))
            n_done = n_until
            yield frame_indices, result
            if progress is not None:
                progress('searching', n_done / n_frames)


def _linked(shared: SharedSearch, parts: Sequence[NDArray[np.int64]],
            stamps: NDArray[np.float64], length: int, hop: int, repeated: RepeatedFrames,
            pipeline: TrackingPipeline, progress: Progress | None,
            ) -> Generator[tuple[NDArray[np.int64], DetectionResult]]:
    """Yield as :func:`_searched`, of batches that are searched elsewhere."""
    order = np.concatenate(parts)
    changes = zip(order[1:].tolist(), shared.changes(order, progress), strict=True)
    repeats = {index for index, changed in changes if repeated.is_one(changed)}
    numbers = frames_of_batches(parts, repeats, length, hop)
    found_in = chain.from_iterable(shared.found(spans_of(numbers, stamps), progress))
    for frame_indices, found in zip(numbers, found_in, strict=True):
        if found is not None:
            yield frame_indices, pipeline.link(found, elsewhere=True)


def prepared_batches(cut: Iterable[FrameBatch],
                     prepare: Callable[[FrameBatch, Progress | None], _Search], n_frames: int,
                     progress: Progress | None,
                     ) -> Iterator[tuple[int, NDArray[np.int64], _Search]]:
    """Yield number and frame numbers of each batch that shows anything, and what searches it."""
    for number, batch in enumerate(cut):
        if not np.isfinite(batch.frames).any() and len(batch) < n_frames:
            # A gap in the recording ends no more than the trajectories that reach into it.
            _LOG.warning('frames %d to %d hold no finite pixel and are passed over',
                         batch.frame_indices[0], batch.frame_indices[-1])
            continue
        yield number, batch.frame_indices, prepare(batch, progress)


def _carry_back(pipeline: TrackingPipeline, searched: list[DetectionResult]) -> None:
    """Follow trajectories back into the batches before the one that first found them."""
    later = searched[-1].trajectories
    for result in reversed(searched[:-1]):
        seen = {trajectory.id for trajectory in result.trajectories}
        result.trajectories.extend(pipeline.carried_on(
            [known for known in later if known.id not in seen], result.rejected))
        later = result.trajectories
