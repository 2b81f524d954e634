"""Another search is prepared beside the one that goes on.

No ROS types in here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any, Protocol

from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import OwnThread
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

    The options are what ``request`` chooses by the first ``frames`` of the stream, ``taken`` by
    which sensor; ``earlier`` is the pipeline from which ids are taken over.
    """

    request: StreamRequest
    frames: NDArray
    taken: NDArray | None
    shape: tuple[int, int]
    interval_s: float
    earlier: StreamPipeline


@dataclass(frozen=True)
class Prepared:
    """A search that is ready, for what it was wanted, and the seconds that it took."""

    wanted: Wanted
    choice: Choice
    pipeline: StreamPipeline
    threshold: float
    seconds: float


class Beside(OwnThread[Wanted]):
    """Prepares, in a thread of its own, what was asked for last.

    Parameters
    ----------
    make_pipeline : callable
        Takes options and the pipeline before; returns what searches the batches.
    on_progress : callable
        Takes a label and the share done; runs in the thread, like the next.
    on_done : callable
        Takes a :class:`Prepared`, or why there is none.
    """

    def __init__(self, make_pipeline: MakePipeline, on_progress: Progress,
                 on_done: Callable[[Prepared | Exception], None]):
        super().__init__('preparing')
        self._make_pipeline = make_pipeline
        self._on_progress = on_progress
        self._on_done = on_done
        self._dropped = False
        self._began_s = 0.0

    def drop(self) -> None:
        """Ask for nothing any more."""
        with self.changed:
            self.next, self._dropped = None, True

    def run(self) -> None:
        """Prepare what is wanted."""
        while True:
            with self.changed:
                wanted, self._dropped = self.take(), False
            if wanted is None:
                return
            self._began_s = time.monotonic()
            done: Prepared | Exception | None = None
            try:
                done = self._prepared(wanted)
            except LeftError:
                pass
            except Exception as error:
                done = error
            if done is not None:
                self._on_done(done)
            with self.changed:
                self.changed.wait_for(lambda: self.closed, PAUSE_S)

    def _prepared(self, wanted: Wanted) -> Prepared:
        choice = wanted.request.chosen(wanted.frames, wanted.taken)
        self._progress('choosing', 1.0)
        pipeline = self._make_pipeline(choice.options, wanted.earlier)
        threshold = pipeline.warm_up(
            wanted.shape, wanted.interval_s,
            wanted.request.settings(choice.options).batch_length, self._progress)
        return Prepared(wanted, choice, pipeline, threshold, time.monotonic() - self._began_s)

    def _progress(self, label: str, done: float) -> None:
        superseded = (self.next is not None
                      and time.monotonic() - self._began_s > WORTH_FINISHING_S)
        if self.closed or self._dropped or superseded:
            raise LeftError
        self._on_progress(label, done)
