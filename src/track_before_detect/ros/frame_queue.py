"""What callbacks hand to the search thread: frames, what is asked for, a flush.

No ROS types in here.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.batcher import DEFAULT_LENGTH, hop_of, SlidingWindow
from track_before_detect.tracking.presets import (
    AUTO,
    Choice,
    choose_for_sensors,
    choose_options,
    FRAMES_OF_SENSOR,
    FRAMES_SEEN,
    NONE,
)

# Stamps and parameters may ask for more seconds than a lock can wait.
LONGEST_WAIT_S = 86400.0


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
    sensor : int
        Which of several sensors took it.
    """

    pixels: NDArray
    stamp_s: float
    tag: Any
    arrival_s: float
    index: int
    sensor: int = 0


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
class LookedAt:
    """What is known before of one of several sensors, at whose first frames is looked.

    Attributes
    ----------
    name : str
    shape : tuple of int
        (H, W) of its frames, the first rows and columns of those that are handed over.
    noise_sigma : float
        Standard deviation of their noise.
    """

    name: str
    shape: tuple[int, int]
    noise_sigma: float


@dataclass(frozen=True)
class StreamRequest:
    """What was told about a stream; the rest is chosen.

    Attributes
    ----------
    preset : str
        Where the options come from that were not told: of the presets by name, or ``auto``.
    told : mapping
        Names and values of options.
    max_gap_s, queue_length, flush_after_s
        See :class:`StreamSettings`; None is automatic.
    sensors : tuple of LookedAt
        Those from which frames come, where they are several.
    """

    preset: str
    told: Mapping[str, Any]
    max_gap_s: float | None = None
    queue_length: int | None = None
    flush_after_s: float | None = None
    sensors: tuple[LookedAt, ...] = ()

    @property
    def looks(self) -> bool:
        """Whether frames have to be seen before all is chosen."""
        return self.preset == AUTO

    @cached_property
    def unseen(self) -> Choice:
        """What is known without a frame, raising ParameterError for what cannot be."""
        preset = NONE if self.preset == AUTO else self.preset
        return self._complete(choose_options(preset, self.told, np.empty((0, 0, 0))))

    def chosen(self, frames: NDArray, taken: NDArray | None = None) -> Choice:
        """Return options for a stream that begins with frames (T, H, W), none automatic.

        ``taken`` (T,) says which of several sensors took each.
        """
        if not self.looks:
            return self.unseen
        if taken is None:
            return self._complete(choose_options(self.preset, self.told, frames))
        return self._complete(choose_for_sensors(self.told, {
            one.name: frames[taken == number, :one.shape[0], :one.shape[1]] / one.noise_sigma
            for number, one in enumerate(self.sensors)}))

    def window(self, options: DetectorOptions | None) -> SlidingWindow:
        """Return an empty window for options that were chosen, for a look where None."""
        settings = self.settings(options or self.unseen.options)
        if options is None:
            seen = FRAMES_OF_SENSOR * len(self.sensors) if self.sensors else FRAMES_SEEN
            length = hop = min(seen, settings.batch_length)
        else:
            length, hop = settings.batch_length, settings.hop
        return SlidingWindow(length, hop, settings.max_gap_s, bool(self.sensors))

    def settings(self, options: DetectorOptions) -> StreamSettings:
        """Return how the stream is cut and buffered for options that were chosen."""
        length, hop = options.batch_length or DEFAULT_LENGTH, options.hop or 1
        return StreamSettings(length, hop, self.max_gap_s, self.queue_length or 2 * length,
                              self.flush_after_s)

    def _complete(self, choice: Choice) -> Choice:
        options, reasons = choice
        length = options.batch_length or DEFAULT_LENGTH
        return Choice(options.replace(
            batch_length=length, hop=options.hop or hop_of(length)), reasons)


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
    """The next thing to do: search otherwise, take a frame, or flush; nothing after a pause.

    ``prepared`` is what was handed over, a search that is ready.
    """

    request: StreamRequest | None = None
    prepared: Any = None
    frame: StreamFrame | None = None
    flush: bool = False


class FrameQueue:
    """Bounded queue of frames from which the oldest are dropped, so that intake never waits.

    Requests overtake the frames that wait; a flush comes after them.

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
        self._request: StreamRequest | None = None
        self._prepared: Any = None
        self._flush_asked = False

    def __len__(self) -> int:
        return len(self._frames)

    def put(self, pixels: NDArray, stamp_s: float, tag: Any, sensor: int = 0) -> int:
        """Take in one frame, shape (H, W); return how many were dropped to make room."""
        with self._changed:
            self._frames.append(StreamFrame(
                pixels, stamp_s, tag, time.monotonic(), self.counters.received, sensor))
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

    def drop_message(self) -> None:
        """Count a message that comes while no frames are wanted."""
        with self._changed:
            self.counters.received += 1
            self.counters.dropped += 1

    def discard(self) -> None:
        """Drop the frames that wait."""
        with self._changed:
            self.counters.dropped += len(self._frames)
            self._frames.clear()

    def hand_over(self, prepared: Any) -> None:
        """Let the search thread have what was prepared beside it; the newest counts."""
        with self._changed:
            self._prepared = prepared
            self._changed.notify()

    def configure(self, request: StreamRequest) -> None:
        """Ask for something else from the next batch on."""
        with self._changed:
            self._request = request
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
            self._changed.wait_for(self._has_work, timeout_s and min(timeout_s, LONGEST_WAIT_S))
            if self.closed:
                return None
            if self._prepared is not None:
                prepared, self._prepared = self._prepared, None
                return Work(prepared=prepared)
            if self._request is not None:
                request, self._request = self._request, None
                return Work(request=request)
            if self._frames:
                return Work(frame=self._frames.popleft())
            flush, self._flush_asked = self._flush_asked, False
            return Work(flush=flush)

    def _has_work(self) -> bool:
        return bool(self.closed or self._frames or self._request or self._prepared
                    or self._flush_asked)
