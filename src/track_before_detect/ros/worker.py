"""The thread between intake and output: window, pipeline, counters. No ROS types in here."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import logging
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import TbdError
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.batcher import Outcome, SlidingWindow
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import DetectionResult, FrameBatch

logger = logging.getLogger(__name__)

DEFAULT_BATCH_LENGTH = 20
# Enough frames to know their interval before the search is prepared for it.
FRAMES_TO_LEARN = 3
AUTOMATIC_FLUSH_INTERVALS = 5
AUTOMATIC_FLUSH_MINIMUM_S = 1.0


@dataclass(frozen=True)
class StreamFrame:
    """One frame on its way to the search.

    Attributes
    ----------
    pixels : array, shape (H, W)
        Native byte order.
    stamp_s : float
        Seconds.
    tag : object
        Comes back with the results that contain the frame: the message's header.
    arrival_s : float
        Monotonic clock at intake.
    index : int
        Number of the frame in the stream.
    """

    pixels: NDArray
    stamp_s: float
    tag: Any
    arrival_s: float
    index: int


@dataclass(frozen=True)
class StreamSettings:
    """How the stream is cut and buffered.

    Attributes
    ----------
    batch_length, hop : int
        Frames.
    max_gap_s : float or None
        Longest pause within a batch; None is the duration of a batch.
    queue_length : int
        Frames waiting at most while a batch is searched; the oldest are dropped.
    flush_after_s : float or None
        Idle time after which frames that were in no batch yet are searched all the same; None
        is five frame intervals, at least a second.
    """

    batch_length: int
    hop: int
    max_gap_s: float | None
    queue_length: int
    flush_after_s: float | None


@dataclass(frozen=True)
class StreamResult:
    """Trajectories of one batch.

    Attributes
    ----------
    detection : DetectionResult
        What was found in the batch.
    batch : FrameBatch
        The frames.
    tags : dict
        Frame index to the tag given at intake.
    interval_s : float
        Median time between the frames of the batch, 0 when there is only one.
    """

    detection: DetectionResult
    batch: FrameBatch
    tags: dict[int, Any]
    interval_s: float


@dataclass
class Counters:
    """What happened so far; frames are counted once, as used, refused or dropped."""

    received: int = 0
    used: int = 0
    refused: int = 0
    dropped: int = 0
    restarts: int = 0
    batches: int = 0
    trajectories: int = 0
    failures: int = 0


@dataclass
class Status:
    """Where the worker is, for diagnostics."""

    state: str = 'waiting for frames'
    detail: str = ''
    progress: float = 0.0
    threshold: float = float('nan')
    processing_s: float = 0.0
    longest_processing_s: float = 0.0
    latency_s: float = 0.0
    shape: tuple[int, int] | None = None
    searching: bool = False


class _StopRequestedError(Exception):
    """Raised inside the pipeline's progress callback to leave a long preparation."""


class StreamWorker:
    """Search a stream of frames in a thread of its own.

    Intake never waits: frames go to a bounded queue from which the oldest are dropped.

    Parameters
    ----------
    options : DetectorOptions
        Of the pipeline.
    settings : StreamSettings
        Of the window and the queue.
    expected_shape : tuple of int, optional
        Height and width; with ``expected_interval_s`` the search is prepared before the first
        frame arrives.
    expected_interval_s : float, optional
        Time between frames in seconds.
    on_result : callable
        Takes a :class:`StreamResult`; runs in the worker's thread, like those below.
    on_reset : callable
        Takes nothing; ids start again.
    on_state : callable
        Takes nothing; :attr:`status` has changed.
    on_warning : callable
        Takes a kind, for throttling, and a sentence.
    """

    def __init__(self, options: DetectorOptions, settings: StreamSettings, *,
                 expected_shape: tuple[int, int] | None = None,
                 expected_interval_s: float | None = None,
                 on_result: Callable[[StreamResult], None],
                 on_reset: Callable[[], None],
                 on_state: Callable[[], None],
                 on_warning: Callable[[str, str], None]):
        self.counters = Counters()
        self.status = Status()
        self._on_result = on_result
        self._on_reset = on_reset
        self._on_state = on_state
        self._on_warning = on_warning
        self._options = options
        self._settings = settings
        self._expected = (expected_shape, expected_interval_s)
        self._pipeline = TrackingPipeline(options)
        self._window = SlidingWindow(settings.batch_length, settings.hop, settings.max_gap_s)
        self._prepared_for: tuple[int, int] | None = None
        self._failed_for: tuple[int, int] | None = None
        self._ready_text = ''
        self._tags: dict[int, Any] = {}
        self._last_arrival_s = 0.0
        self._changed = threading.Condition()
        # The queue and what follows are guarded by the condition's lock.
        self._queue: deque[StreamFrame] = deque()
        self._pending: tuple[DetectorOptions, StreamSettings] | None = None
        self._flush_asked = False
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name='search', daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self, timeout_s: float) -> bool:
        """Ask the thread to end; return whether it did in time."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def put(self, pixels: NDArray, stamp_s: float, tag: Any) -> None:
        """Take in one frame, shape (H, W); drop the oldest waiting one when there is no room."""
        with self._changed:
            frame = StreamFrame(
                pixels, stamp_s, tag, time.monotonic(), self.counters.received)
            self.counters.received += 1
            self._queue.append(frame)
            n_dropped = 0
            while len(self._queue) > self._settings.queue_length:
                self._queue.popleft()
                n_dropped += 1
            self.counters.dropped += n_dropped
            self._changed.notify()
        if n_dropped:
            self._on_warning('dropped', (
                f'searching cannot keep up: {self.counters.dropped} of {self.counters.received} '
                'frames were dropped so far'))

    def refuse(self) -> None:
        """Count a message that could not be turned into a frame."""
        with self._changed:
            self.counters.received += 1
            self.counters.refused += 1

    def configure(self, options: DetectorOptions, settings: StreamSettings) -> None:
        """Use other options and settings from the next batch on."""
        with self._changed:
            self._pending = (options, settings)
            self._changed.notify()

    def flush(self) -> None:
        """Have the frames that were in no batch yet searched now, those waiting included."""
        with self._changed:
            self._flush_asked = True
            self._changed.notify()

    def queue_size(self) -> int:
        """Return the number of waiting frames."""
        return len(self._queue)

    def _run(self):
        try:
            self._prepare_expected()
            while self._step():
                pass
        except _StopRequestedError:
            pass
        except Exception:
            # Nothing restarts this thread, so its end must not go unnoticed.
            logger.exception('the search thread has ended')
            self._set_state('failed', 'the search thread has ended; see the log')
            raise

    def _step(self):
        """Do the next thing; return False when asked to stop."""
        with self._changed:
            self._changed.wait_for(self._has_work, self._idle_time_left())
            if self._stopping:
                return False
            pending, self._pending = self._pending, None
            frame = self._queue.popleft() if pending is None and self._queue else None
            flush = False
            if pending is None and frame is None:
                flush, self._flush_asked = self._flush_asked, False
        if pending is not None:
            self._reconfigure(*pending)
        elif frame is not None:
            self._take(frame)
        elif flush or self._idle_time_left() == 0.0:
            self._search(self._window.flush())
        return True

    def _has_work(self):
        return bool(self._stopping or self._queue or self._pending or self._flush_asked)

    def _idle_time_left(self):
        """Return the seconds until held frames are searched without waiting for more."""
        if not self._window.n_new:
            return None
        idle = self._settings.flush_after_s
        if idle is None:
            idle = max(AUTOMATIC_FLUSH_MINIMUM_S, AUTOMATIC_FLUSH_INTERVALS
                       * (self._window.median_interval_s or 0.0))
        return max(0.0, self._last_arrival_s + idle - time.monotonic())

    def _take(self, frame):
        self._last_arrival_s = time.monotonic()
        if not np.isfinite(frame.pixels).any():
            self._count_refused()
            self._on_warning('not finite', 'expected finite pixels, found none in the frame')
            return
        intake = self._window.add(frame.pixels, frame.stamp_s, frame.index)
        if intake.outcome is Outcome.REFUSED:
            self._count_refused()
            self._on_warning('refused', f'frame refused: {intake.reason}')
            return
        self.counters.used += 1
        self._tags[frame.index] = (frame.tag, frame.arrival_s)
        if len(self._tags) > self._settings.batch_length + 1:
            del self._tags[min(self._tags)]
        if intake.outcome is not Outcome.ACCEPTED:
            self.counters.restarts += 1
            self._on_warning(intake.outcome.value, f'the window starts again: {intake.reason}')
        self._search(intake.batch)
        if intake.outcome is not Outcome.ACCEPTED:
            # What could not be prepared at the rate of before may be at that of now.
            self._failed_for = None
        if intake.outcome in (Outcome.JUMP_BACK, Outcome.SIZE_CHANGE):
            self._pipeline.reset()
            self._on_reset()
        if self._prepared_for != frame.pixels.shape and len(self._window) >= FRAMES_TO_LEARN:
            self._prepare(frame.pixels.shape, self._window.median_interval_s)

    def _search(self, batch):
        if batch is None:
            return
        shape = batch.frames.shape[1:]
        interval_s = float(np.median(np.diff(batch.stamps))) if len(batch) > 1 else 0.0
        if self._prepared_for != shape and not self._prepare(shape, interval_s):
            return
        started = time.monotonic()
        self.status.searching = True
        try:
            detection = self._pipeline.process(batch, self._progress)
        except _StopRequestedError:
            raise
        except Exception as error:
            self._failed('the search failed', error)
            self._set_state('ready', self._ready_text)
            return
        finally:
            self.status.searching = False
        if self.status.state != 'ready':
            self._set_state('ready', self._ready_text)
        self.status.shape = shape
        self.counters.batches += 1
        self.counters.trajectories += len(detection.trajectories)
        tags = {int(index): self._tags[int(index)][0] for index in batch.frame_indices}
        try:
            self._on_result(StreamResult(detection, batch, tags, interval_s))
        except Exception as error:
            self._failed('the result could not be handed on', error)
        finished = time.monotonic()
        newest = int(batch.frame_indices[-1])
        self.status.processing_s = finished - started
        self.status.longest_processing_s = max(
            self.status.longest_processing_s, finished - started)
        self.status.latency_s = finished - self._tags[newest][1]
        self.status.threshold = detection.threshold

    def _prepare_expected(self):
        shape, interval_s = self._expected
        if shape is not None:
            self._prepare(shape, interval_s)
        else:
            self._set_state('waiting for frames', 'size and rate are learnt from the first ones')

    def _prepare(self, shape, interval_s):
        """Compile and calibrate for frames of a size; return whether that worked."""
        if self._failed_for == shape:
            return False
        self.status.shape = shape
        self._set_state('preparing', f'for {shape[0]} x {shape[1]} frames')
        started = time.monotonic()
        try:
            threshold = self._pipeline.warm_up(
                shape, interval_s or 1.0, self._settings.batch_length, self._progress)
        except _StopRequestedError:
            raise
        except Exception as error:
            self._failed_for = shape
            self._failed('preparing the search failed', error)
            self._set_state('failed', f'preparing the search failed: {error}')
            return False
        self._prepared_for = shape
        self.status.threshold = threshold
        self._ready_text = (
            f'{shape[0]} x {shape[1]} frames, threshold {threshold:.3f}, batches of '
            f'{self._settings.batch_length} frames every {self._settings.hop}, prepared in '
            f'{time.monotonic() - started:.1f} s')
        self._set_state('ready', self._ready_text)
        return True

    def _progress(self, label, done):
        if self._stopping:
            raise _StopRequestedError
        self.status.progress = done
        self._set_state(label, f'{100.0 * done:.0f} %')

    def _reconfigure(self, options, settings):
        same_window = (settings.batch_length, settings.hop, settings.max_gap_s) == (
            self._settings.batch_length, self._settings.hop, self._settings.max_gap_s)
        if not same_window:
            self._search(self._window.flush())
            self._window = SlidingWindow(settings.batch_length, settings.hop, settings.max_gap_s)
        rebuild = options != self._options or settings.batch_length != self._settings.batch_length
        self._options, self._settings = options, settings
        if not rebuild:
            return
        shape, interval_s = self._window.shape, self._window.median_interval_s
        if shape is None or interval_s is None:
            shape, interval_s = self._expected
        self._pipeline = TrackingPipeline(options, self._pipeline)
        self._prepared_for = self._failed_for = None
        if shape is not None:
            self._prepare(shape, interval_s)
        else:
            self._set_state('waiting for frames', 'size and rate are learnt from the first ones')

    def _count_refused(self):
        with self._changed:
            self.counters.refused += 1

    def _failed(self, what, error):
        self.counters.failures += 1
        if not isinstance(error, TbdError):
            logger.debug('%s', what, exc_info=error)
        self._on_warning('failure', f'{what}: {type(error).__name__}: {error}')

    def _set_state(self, state, detail):
        self.status.state, self.status.detail = state, detail
        self._on_state()
