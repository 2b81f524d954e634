"""Another search is prepared beside the one that goes on.

No ROS types in here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import threading
import time
from typing import Any, Protocol

from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.ros.frame_queue import StreamRequest
from track_before_detect.tracking.presets import Choice
from track_before_detect.tracking.recording import BatchPipeline
from track_before_detect.types import Progress

# A preparation that has taken longer is left for what is asked for next; a shorter one is
# finished, so that of options that change all the time some take effect.
WORTH_FINISHING_S = 0.5
# From one preparation to the next, so that the search keeps most of the processor.
PAUSE_S = 0.1


class StreamPipeline(BatchPipeline, Protocol):
    """What finds the trajectories of a stream; see :class:`TrackingPipeline`."""

    def compile(self, progress: Progress | None = None) -> None:
        """Run every kernel once."""

    def warm_up(self, shape: tuple[int, int], interval_s: float, n_frames: int,
                progress: Progress | None = None) -> float:
        """Compile every kernel, and return the threshold, NaN where a batch decides it."""

    def reset(self) -> None:
        """Forget identities and earlier batches."""


# Told options and the pipeline before, which is of the same kind.
MakePipeline = Callable[[DetectorOptions, Any], StreamPipeline]


class LeftError(Exception):
    """A preparation is not wanted any more."""


@dataclass(frozen=True)
class Wanted:
    """What is to be prepared, and for which frames.

    Attributes
    ----------
    request : StreamRequest
        What was asked for.
    frames : array, shape (T, H, W)
        The first of the stream, by which the rest is chosen.
    taken : array of int, shape (T,), or None
        Which of several sensors took them.
    shape : tuple of int
        Height and width.
    interval_s : float
        Between frames.
    earlier : StreamPipeline
        From which ids are taken over.
    """

    request: StreamRequest
    frames: NDArray
    taken: NDArray | None
    shape: tuple[int, int]
    interval_s: float
    earlier: StreamPipeline


@dataclass(frozen=True)
class Prepared:
    """A search that is ready, or why there is none.

    Attributes
    ----------
    wanted : Wanted
        What it was prepared for.
    choice : Choice or None
        Its options.
    pipeline : StreamPipeline or None
        Compiled and calibrated.
    threshold : float
        On the statistic.
    seconds : float
        That it took.
    error : Exception or None
        Why it cannot be used.
    """

    wanted: Wanted
    choice: Choice | None = None
    pipeline: StreamPipeline | None = None
    threshold: float = float('nan')
    seconds: float = 0.0
    error: Exception | None = None


class Beside:
    """Prepares, in a thread of its own, what was asked for last.

    Parameters
    ----------
    make_pipeline : callable
        Takes options and the pipeline before; returns what searches the batches.
    on_progress : callable
        Takes a label and the share done; runs in the thread, like the next.
    on_done : callable
        Takes a :class:`Prepared`.
    """

    def __init__(self, make_pipeline: MakePipeline, on_progress: Progress,
                 on_done: Callable[[Prepared], None]):
        self._make_pipeline = make_pipeline
        self._on_progress = on_progress
        self._on_done = on_done
        self._changed = threading.Condition()
        self._wanted: Wanted | None = None
        self._dropped = self._closed = False
        self._began_s = 0.0
        self._thread = threading.Thread(target=self._run, name='preparing', daemon=True)

    def ask(self, wanted: Wanted) -> None:
        """Ask for a preparation in place of what was asked for before."""
        with self._changed:
            if self._closed:
                return
            if not self._thread.is_alive():
                self._thread.start()
            self._wanted = wanted
            self._changed.notify()

    def drop(self) -> None:
        """Ask for nothing any more."""
        with self._changed:
            self._wanted, self._dropped = None, True

    def close(self) -> None:
        """Ask the thread to end."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of the thread; return whether it came in time."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wanted is not None)
                if self._closed:
                    return
                wanted, self._wanted, self._dropped = self._wanted, None, False
            assert wanted is not None
            self._began_s = time.monotonic()
            try:
                self._on_done(self._prepared(wanted))
            except LeftError:
                pass
            with self._changed:
                self._changed.wait_for(lambda: self._closed, PAUSE_S)

    def _prepared(self, wanted: Wanted) -> Prepared:
        try:
            choice = wanted.request.chosen(wanted.frames, wanted.taken)
            self._progress('choosing', 1.0)
            pipeline = self._make_pipeline(choice.options, wanted.earlier)
            threshold = pipeline.warm_up(
                wanted.shape, wanted.interval_s,
                wanted.request.settings(choice.options).batch_length, self._progress)
        except LeftError:
            raise
        except Exception as error:
            return Prepared(wanted, error=error)
        return Prepared(wanted, choice, pipeline, threshold, time.monotonic() - self._began_s)

    def _progress(self, label: str, done: float) -> None:
        superseded = (self._wanted is not None
                      and time.monotonic() - self._began_s > WORTH_FINISHING_S)
        if self._closed or self._dropped or superseded:
            raise LeftError
        self._on_progress(label, done)
