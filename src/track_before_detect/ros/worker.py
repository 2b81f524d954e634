"""From the queue to the window, from there to the pipeline: a stream searched in two threads.

One takes frames and prepares batches, while the other searches the batch before. No ROS types in
here.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import logging
import threading
import time

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, TbdError
from track_before_detect.parallel import at_most_cores, usable_cores
from track_before_detect.ros.beside import (
    Beside,
    MakePipeline,
    Prepared,
    StreamPipeline,
    Wanted,
)
from track_before_detect.ros.frame_queue import FrameQueue, StreamFrame, StreamRequest
from track_before_detect.ros.in_turn import InTurn
from track_before_detect.ros.intake.sensor_stream import SensorStream
from track_before_detect.ros.search_results import Status, StreamResult
from track_before_detect.tracking.batcher import Intake, Outcome
from track_before_detect.tracking.pipeline import BatchSearch, TrackingPipeline
from track_before_detect.tracking.presets import Choice
from track_before_detect.types import Count, FrameBatch

logger = logging.getLogger(__name__)

# Enough frames to know their interval before the search is prepared for it.
FRAMES_TO_LEARN = 3
AUTOMATIC_FLUSH_INTERVALS = 5
AUTOMATIC_FLUSH_MINIMUM_S = 1.0
NO_FRAME = -1


class _StopRequestedError(Exception):
    """Raised inside the pipeline's progress callback to leave a long preparation."""


class StreamWorker:
    """Search a stream of frames in threads of its own.

    Where frames wait, a batch is prepared on one core while another searches the one before; a
    batch that is prepared by then is still searched with the options of before a change.

    Parameters
    ----------
    request : StreamRequest
        What is searched and how the stream is cut, or that the first frames decide it.
    expected_shape : tuple of int, optional
        Height and width; with ``expected_interval_s`` the search is prepared before the first
        frame arrives.
    expected_interval_s : float, optional
        Time between frames in seconds.
    on_result : callable
        Takes a :class:`StreamResult`; runs in a thread of the worker, like those below.
    on_reset : callable
        Takes nothing; another stream begins, and with it other trajectories.
    on_state : callable
        Takes nothing; :attr:`status` has changed.
    on_choice : callable
        Takes nothing; the first frames of a stream have decided on other options.
    on_warning : callable
        Takes a kind, for throttling, and a sentence.
    make_pipeline : callable
        Takes options and the pipeline before, or None; returns what searches the batches.
    sensors : SensorStream, optional
        Puts the frames of several sensors in order.

    Attributes
    ----------
    queue : FrameQueue
        Takes frames, changes of settings and flushes.
    status : Status
        Where the search is.
    """

    def __init__(self, request: StreamRequest, *,
                 expected_shape: tuple[int, int] | None = None,
                 expected_interval_s: float | None = None,
                 on_result: Callable[[StreamResult], None],
                 on_reset: Callable[[], None],
                 on_state: Callable[[], None],
                 on_choice: Callable[[], None],
                 on_warning: Callable[[str, str], None],
                 make_pipeline: MakePipeline = TrackingPipeline,
                 sensors: SensorStream | None = None) -> None:
        self.queue = FrameQueue(request.settings(request.unseen.options).queue_length)
        self.status = Status()
        self._counters = self.queue.counters
        self._on_result = on_result
        self._on_reset = on_reset
        self._on_state = on_state
        self._on_choice = on_choice
        self._on_warning = on_warning
        self._make_pipeline = make_pipeline
        self._sensors = sensors
        self._request = request
        self._expected = (expected_shape, expected_interval_s)
        self._options = request.unseen.options
        self._settings = request.settings(self._options)
        self._pipeline = make_pipeline(self._options, None)
        # Whether the frames in the window are to be looked at first, and those that were.
        self._looking = request.looks
        self._seen: NDArray = np.empty((0, 0, 0))
        self._seen_by: NDArray | None = None
        self._prepared_for: tuple[int, int] | None = None
        self._failed_for: tuple[int, int] | None = None
        self._prepared_s = 0.0
        self._held: dict[int, StreamFrame] = {}
        # That of the frame whose stamp goes back, until the next one tells what it is.
        self._waiting = NO_FRAME
        self._last_arrival_s = 0.0
        self._window = request.window(None if request.looks else self._options)
        self._adopt(request.unseen)
        self._beside = Beside(make_pipeline, self._progress_beside, self.queue.hand_over)
        self._beside_counts = False
        self._first_prepared = threading.Event()
        self._searches = InTurn('search')
        self._thread = threading.Thread(target=self._run, name='intake', daemon=True)

    def start(self) -> None:
        """Begin to compile, and to calibrate as far as it is known for what."""
        self._thread.start()

    def wait_until_prepared(self) -> bool:
        """Wait for the preparation at the start; return whether it worked."""
        self._first_prepared.wait()
        return not self.queue.closed and self.status.state != 'failed'

    def stop(self, timeout_s: float) -> bool:
        """Ask the threads to end; return whether they did in time."""
        end_s = time.monotonic() + timeout_s
        self.queue.close()
        self._beside.close()
        self._searches.close()
        self._first_prepared.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return (self._beside.join(max(0.0, end_s - time.monotonic()))
                and self._searches.join(max(0.0, end_s - time.monotonic()))
                and not self._thread.is_alive())

    def _run(self) -> None:
        try:
            self._prepare_or_wait(*self._expected)
            self._first_prepared.set()
            while (work := self.queue.take(self._time_left())) is not None:
                if work.prepared is not None:
                    self._switch(work.prepared)
                elif work.request is not None:
                    self._reconfigure(work.request)
                elif work.frame is not None:
                    self._take(work.frame)
                elif work.flush or self._idle_time_left() == 0.0:
                    self._flush()
                if self._sensors is not None and not len(self.queue):
                    for frame in self._sensors.due(time.monotonic()):
                        self._add(frame)
        except _StopRequestedError:
            pass
        except Exception:
            # Nothing restarts these threads, so their end must not go unnoticed.
            logger.exception('the search thread has ended')
            self._set_state('failed', 'the search thread has ended; see the log')
            raise
        finally:
            self._first_prepared.set()

    def _time_left(self) -> float | None:
        """Return the seconds until something is to be done without a new frame."""
        idle = self._idle_time_left()
        deadline = self._sensors.deadline_s if self._sensors is not None else None
        if deadline is None:
            return idle
        waits = max(0.0, deadline - time.monotonic())
        return waits if idle is None else min(idle, waits)

    def _idle_time_left(self) -> float | None:
        """Return the seconds until held frames are searched without waiting for more."""
        if not self._window.n_new:
            return None
        idle = self._settings.flush_after_s
        if idle is None:
            idle = max(AUTOMATIC_FLUSH_MINIMUM_S, AUTOMATIC_FLUSH_INTERVALS
                       * (self._window.median_interval_s or 0.0))
        return max(0.0, self._last_arrival_s + idle - time.monotonic())

    def _take(self, frame: StreamFrame) -> None:
        """Take a frame; those of several sensors wait for one another."""
        self._last_arrival_s = time.monotonic()
        if not np.isfinite(frame.pixels).any():
            self.queue.refuse()
            self._on_warning('not finite', 'expected finite pixels, found none in the frame')
            return
        if self._sensors is None:
            self._add(frame)
            return
        try:
            in_order = self._sensors.add(frame)
        except DataError as error:
            self._refuse(f'frame refused: {error}')
            return
        for one in in_order:
            self._add(one)

    def _add(self, frame: StreamFrame) -> None:
        """Add a frame to the window, and search the batch that this completes."""
        self._held[frame.index] = frame
        intake = self._window.add(frame.pixels, frame.stamp_s, frame.index)
        if intake.left_out:
            self._refuse(intake.left_out)
            # It is in no batch, and must not take the place of one that is.
            self._held.pop(self._waiting, None)
        self._waiting = frame.index if intake.outcome is Outcome.WAITING else NO_FRAME
        if intake.outcome is Outcome.REFUSED:
            del self._held[frame.index]
            self._refuse(f'frame refused: {intake.reason}')
        if intake.outcome in (Outcome.REFUSED, Outcome.WAITING):
            return
        self._counters.used += 1
        # The tail of a window that was started again, this frame, and one that waited.
        while len(self._held) > self._window.length + 2:
            del self._held[min(self._held)]
        if intake.outcome is Outcome.ACCEPTED:
            self._search(intake.batch)
        else:
            self._start_again(intake, frame)
        if self._looking:
            self._set_state('looking at the first frames',
                            f'{len(self._window)} of {self._window.length}')
        elif self._prepared_for != frame.pixels.shape and len(self._window) >= FRAMES_TO_LEARN:
            self._prepare(frame.pixels.shape, self._window.median_interval_s)

    def _refuse(self, reason: str) -> None:
        self.queue.refuse()
        self._on_warning('refused', reason)

    def _start_again(self, intake: Intake, frame: StreamFrame) -> None:
        """Search what is left of the stream before, and see whether this is another one."""
        self._counters.restarts += 1
        self._on_warning(intake.outcome.value, f'the window starts again: {intake.reason}')
        self._search(intake.batch)
        self._searches.wait_until_done()
        # What could not be prepared at the rate of before may be at that of now.
        self._failed_for = None
        if intake.outcome is Outcome.JUMP_BACK:
            # The one that waited.
            self._counters.used += 1
        elif self._request.looks and not self._looking:
            self._looking = True
            self._window = self._request.window(None)
            self._window.add(frame.pixels, frame.stamp_s, frame.index)
        if intake.outcome is not Outcome.GAP:
            self._pipeline.reset()
            self._on_reset()

    def _flush(self) -> None:
        """Search the frames that were in no batch yet; a look comes before."""
        for frame in self._sensors.release() if self._sensors is not None else ():
            self._add(frame)
        while (batch := self._window.flush()) is not None:
            self._search(batch)

    def _look(self, batch: FrameBatch, interval_s: float) -> None:
        """Choose by the first frames of a stream, then search them."""
        self._searches.wait_until_done()
        self._set_state('choosing', f'options by {len(batch)} frames')
        self._seen = batch.frames
        if self._sensors is not None:
            self._seen_by = self._taken(batch)[:, 0]
        choice = self._chosen(self._request)
        if choice is None:
            return
        self._looking = False
        self._adopt(choice)
        self._window = self._request.window(self._options)
        shape = batch.frames.shape[1:]
        if self._prepared_for == shape:
            self._set_ready()
        elif not self._prepare(shape, interval_s):
            return
        for index in batch.frame_indices:
            frame = self._held[int(index)]
            self._search(self._window.add(frame.pixels, frame.stamp_s, frame.index).batch)

    def _chosen(self, request: StreamRequest) -> Choice | None:
        """Return what is taken for the frames seen, None if that cannot be searched."""
        try:
            choice = request.chosen(self._seen, self._seen_by)
            # Raises for what the detector in use cannot honour.
            self._make_pipeline(choice.options, None)
            return choice
        except Exception as error:
            self._failed('choosing options failed', error)
            self._set_state('failed', f'choosing options failed: {error}')
            return None

    def _adopt(self, choice: Choice, pipeline: StreamPipeline | None = None) -> bool:
        """Search with other options from now on; return whether they are others."""
        others = choice.options != self._options
        news = others or choice.reasons != self.status.reasons
        if others:
            self._pipeline = pipeline or self._make_pipeline(choice.options, self._pipeline)
            self._prepared_for = self._failed_for = None
        self._options = self.status.options = choice.options
        self._settings = self._request.settings(choice.options)
        self.queue.length = self._settings.queue_length
        self.status.preset, self.status.reasons = self._request.preset, choice.reasons
        if news and choice.reasons:
            self._on_choice()
        return others

    def _search(self, batch: FrameBatch | None) -> None:
        """Prepare a batch, if there is one, and have it searched after the one before."""
        if batch is None:
            return
        shape = batch.frames.shape[1:]
        interval_s = float(np.median(np.diff(batch.stamps))) if len(batch) > 1 else 0.0
        if self._looking:
            self._look(batch, interval_s)
            return
        if self._prepared_for != shape and not self._prepare(shape, interval_s):
            return
        if self._sensors is not None:
            batch = replace(batch, taken=self._taken(batch))
        self._searches.wait_until_begun()
        if usable_cores() == 1:
            self._searches.wait_until_done()
        started = time.monotonic()
        self.status.searching = True
        try:
            with at_most_cores(usable_cores() - self._searches.busy):
                search = self._pipeline.prepare(batch, self._progress)
        except _StopRequestedError:
            raise
        except Exception as error:
            self._searches.wait_until_done()
            self._search_failed(error)
            return
        frames = {index: self._held[index] for index in batch.frame_indices.tolist()}
        self._searches.do(partial(self._find, batch, frames, self._pipeline, search,
                                  self._settings.hop, time.monotonic() - started))

    def _taken(self, batch: FrameBatch) -> NDArray[np.int64]:
        """Return which of several sensors took each frame, and its number, (T, 2)."""
        return np.array([
            (self._held[index].sensor, index) for index in batch.frame_indices.tolist()])

    def _find(self, batch: FrameBatch, frames: dict[int, StreamFrame], pipeline: StreamPipeline,
              search: BatchSearch, hop: int, prepared_s: float) -> None:
        """Search a batch that was prepared, and hand on what was found."""
        started = time.monotonic()
        self.status.searching = True
        try:
            detection = search(self._progress)
        except _StopRequestedError:
            return
        except Exception as error:
            self._search_failed(error)
            return
        finally:
            self.status.searching = False
        self.status.shape = batch.frames.shape[1:]
        if pipeline is self._pipeline:
            self.status.threshold = detection.threshold
        if self.status.state != 'ready':
            self._set_ready()
        self._counters.batches += 1
        self._counters.trajectories += len(detection.trajectories)
        tags = {index: frame.tag for index, frame in frames.items()}
        try:
            self._on_result(StreamResult(
                detection, batch, tags,
                float(np.ptp(batch.stamps)) / max(1, len(batch) - 1), hop))
        except Exception as error:
            self._failed('the result could not be handed on', error)
        finished = time.monotonic()
        newest = frames[int(batch.frame_indices[-1])]
        self.status.processing_s = prepared_s + finished - started
        self.status.longest_processing_s = max(
            self.status.longest_processing_s, self.status.processing_s)
        self.status.latency_s = finished - newest.arrival_s

    def _search_failed(self, error: Exception) -> None:
        self.status.searching = False
        self._failed('the search failed', error)
        self._set_ready()

    def _prepare_or_wait(self, shape: tuple[int, int] | None, interval_s: float | None) -> None:
        """Prepare the search for frames of a size; compile it if that is not known yet."""
        self._searches.wait_until_done()
        if shape is not None:
            self._prepare(shape, interval_s)
        elif self._warm_up(None, 1.0):
            self._set_state('waiting for frames', 'size and rate are learnt from the first ones')

    def _prepare(self, shape: tuple[int, int], interval_s: float | None) -> bool:
        """Compile and calibrate for frames of a size; return whether that worked."""
        if self._failed_for == shape:
            return False
        self._searches.wait_until_done()
        self.status.shape = shape
        self._set_state('preparing', f'for {shape[0]} x {shape[1]} frames')
        # A threshold that the first frames may change is not worth a calibration.
        compiles_only = self._looking and self._options.threshold is None
        if not self._warm_up(None if compiles_only else shape, interval_s or 1.0):
            self._failed_for = shape
            return False
        self._prepared_for = None if compiles_only else shape
        self._set_ready()
        return True

    def _warm_up(self, shape: tuple[int, int] | None, interval_s: float) -> bool:
        """Compile, and calibrate for frames of a size if any; return whether that worked."""
        started = time.monotonic()
        self.status.threshold = float('nan')
        try:
            if shape is None:
                self._pipeline.compile(self._progress)
            else:
                self.status.threshold = self._pipeline.warm_up(
                    shape, interval_s, self._settings.batch_length, self._progress)
        except _StopRequestedError:
            raise
        except Exception as error:
            self._failed('preparing the search failed', error)
            self._set_state('failed', f'preparing the search failed: {error}')
            return False
        self._prepared_s = time.monotonic() - started
        return True

    def _set_ready(self) -> None:
        height, width = self.status.shape or (0, 0)
        words = [f'{height} x {width} frames']
        if np.isfinite(self.status.threshold):
            words.append(f'threshold {self.status.threshold:.3f}')
        words += [f'batches of {self._settings.batch_length} frames every {self._settings.hop}',
                  f'prepared in {self._prepared_s:.1f} s']
        if self._looking:
            words.append(f'the first {self._window.length} frames choose what was not told')
        self._set_state('ready', ', '.join(words))

    def _progress(self, label: str, done: float) -> None:
        if self.queue.closed:
            raise _StopRequestedError
        if label == 'searching':
            # A state of its own for each batch would fill the log.
            return
        self._set_state(label, str(done) if isinstance(done, Count) else f'{100.0 * done:.0f} %')

    def _progress_beside(self, label: str, done: float) -> None:
        self.status.beside = f'{label} other options: {100.0 * done:.0f} %'
        self._on_state()

    def _reconfigure(self, request: StreamRequest) -> None:
        """Prepare what is asked for, beside a search that goes on if there is one."""
        looking = request.looks and (self._looking or not len(self._seen))
        shape = self._prepared_for
        self._beside_counts = shape is not None and not looking
        if shape is not None and self._beside_counts:
            self._beside.hand_over(Wanted(
                request, self._seen, self._seen_by, shape,
                self._window.median_interval_s or self._expected[1] or 1.0, self._pipeline))
            return
        self._beside.drop()
        self.status.beside = ''
        choice = request.unseen if looking else self._chosen(request)
        if choice is None:
            return
        shape, interval_s = self._window.shape, self._window.median_interval_s
        if shape is None or interval_s is None:
            shape, interval_s = self._expected
        self._looking = looking
        if self._use(request, choice):
            self._prepare_or_wait(shape, interval_s)

    def _switch(self, prepared: Prepared | Exception) -> None:
        """Go over to a search that was prepared beside the present one, from this frame on."""
        self.status.beside = ''
        if not self._beside_counts:
            return
        if isinstance(prepared, Exception):
            self._failed('preparing what was changed failed, and the search goes on as before',
                         prepared)
            return
        wanted, choice = prepared.wanted, prepared.choice
        if self._looking:
            # Another stream has begun meanwhile, which is looked at first.
            self._reconfigure(wanted.request)
            return
        if self._use(wanted.request, choice, prepared.pipeline):
            self._prepared_for, self._prepared_s = wanted.shape, prepared.seconds
            self.status.shape, self.status.threshold = wanted.shape, prepared.threshold
        self._set_ready()

    def _use(self, request: StreamRequest, choice: Choice,
             pipeline: StreamPipeline | None = None) -> bool:
        """Search what is asked for with options; return whether they are others than before."""
        window = request.window(None if self._looking else choice.options)
        if (window.length, window.hop, window.max_gap_s) != (
                self._window.length, self._window.hop, self._window.max_gap_s):
            self._flush()
            self._window = window
        self._request = request
        return self._adopt(choice, pipeline)

    def _failed(self, what: str, error: Exception) -> None:
        self._counters.failures += 1
        if not isinstance(error, TbdError):
            logger.debug('%s', what, exc_info=error)
        self._on_warning('failure', f'{what}: {type(error).__name__}: {error}')

    def _set_state(self, state: str, detail: str) -> None:
        self.status.state, self.status.detail = state, detail
        self._on_state()
