"""What callbacks hand to the search thread: frames, changes of settings, a flush.

No ROS types in here.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import threading
import time
from typing import Any

from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions


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


@dataclass(frozen=True)
class Work:
    """The next thing to do: use other settings, take a frame, or flush; nothing after a pause."""

    changes: tuple[DetectorOptions, StreamSettings] | None = None
    frame: StreamFrame | None = None
    flush: bool = False


class FrameQueue:
    """Bounded queue of frames from which the oldest are dropped, so that intake never waits.

    Changes of settings overtake the frames that wait; a flush comes after them.

    Parameters
    ----------
    length : int
        Frames waiting at most.

    Attributes
    ----------
    counters : Counters
        ``received``, ``dropped`` and ``refused`` are counted here.
    closed : bool
        Whether there is no more work to be done.
    """

    def __init__(self, length: int) -> None:
        self.length = length
        self.counters = Counters()
        self.closed = False
        self._changed = threading.Condition()
        self._frames: deque[StreamFrame] = deque()
        self._changes: tuple[DetectorOptions, StreamSettings] | None = None
        self._flush_asked = False

    def __len__(self) -> int:
        return len(self._frames)

    def put(self, pixels: NDArray, stamp_s: float, tag: Any) -> int:
        """Take in one frame, shape (H, W); return how many were dropped to make room."""
        with self._changed:
            self._frames.append(StreamFrame(
                pixels, stamp_s, tag, time.monotonic(), self.counters.received))
            self.counters.received += 1
            n_dropped = max(0, len(self._frames) - self.length)
            for _ in range(n_dropped):
                self._frames.popleft()
            self.counters.dropped += n_dropped
            self._changed.notify()
        return n_dropped

    def refuse(self) -> None:
        """Count a frame that was taken but cannot be searched."""
        with self._changed:
            self.counters.refused += 1

    def refuse_message(self) -> None:
        """Count a message that could not be turned into a frame."""
        with self._changed:
            self.counters.received += 1
            self.counters.refused += 1

    def configure(self, options: DetectorOptions, settings: StreamSettings) -> None:
        """Ask for other options and settings from the next batch on."""
        with self._changed:
            self._changes = (options, settings)
            self._changed.notify()

    def flush(self) -> None:
        """Ask for the frames that were in no batch yet to be searched, those waiting included."""
        with self._changed:
            self._flush_asked = True
            self._changed.notify()

    def close(self) -> None:
        """Ask the search thread to end."""
        with self._changed:
            self.closed = True
            self._changed.notify()

    def take(self, timeout_s: float | None) -> Work | None:
        """Wait for work, at most some seconds; return it, or None once the queue is closed."""
        with self._changed:
            self._changed.wait_for(self._has_work, timeout_s)
            if self.closed:
                return None
            if self._changes is not None:
                changes, self._changes = self._changes, None
                return Work(changes=changes)
            if self._frames:
                return Work(frame=self._frames.popleft())
            flush, self._flush_asked = self._flush_asked, False
            return Work(flush=flush)

    def _has_work(self) -> bool:
        return bool(self.closed or self._frames or self._changes or self._flush_asked)
