"""Cut a stream of frames into overlapping batches, and mind its gaps, jumps and repeats."""

from collections import deque
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.types import FrameBatch

# Frames stamped on arrival may come in bunches at the start; less than this is no gap then.
SHORTEST_FIRST_GAP_S = 1.0
# Frames of a batch where nothing is said of them, and the most that are one batch all the same.
DEFAULT_LENGTH, MOST_IN_ONE = 20, 40
# Of frames searched together, in single precision: for each the smallest table of a search takes
# as much, and the most that one may take is solvers/search/affordable.MOST_TABLE_BYTES.
MOST_BATCH_BYTES = 2 * 2**30


def hop_of(length: int) -> int:
    """Return the frames from one batch to the next where nothing is said of them: half a batch.

    Every target is then seen in whole batches but at its ends.
    """
    return max(1, length // 2)


def length_of(n_frames: int) -> int | None:
    """Return the length of the batches of a recording, None where it is one batch."""
    return DEFAULT_LENGTH if n_frames > MOST_IN_ONE else None


def check_batch_size(name: str, shape: tuple[int, int], n_frames: int,
                     batch_length: int | None) -> None:
    """Refuse frames (H, W) of which a batch could not be searched, before any is read.

    Parameters
    ----------
    name : str
        Of the recording.
    shape : tuple of int
        Height and width.
    n_frames : int
        Of the recording.
    batch_length : int or None
        As told; None where it is left to be chosen.
    """
    length = min(n_frames, batch_length or DEFAULT_LENGTH)
    n_bytes = 4 * length * shape[0] * shape[1]
    if n_bytes > MOST_BATCH_BYTES:
        raise DataError(
            f'{name} is too large to search: {length} frames of {shape[1]} x {shape[0]} pixels at '
            f'a time take {n_bytes / 1e9:.3g} GB, and the tables of a search as much again, at '
            f'most {MOST_BATCH_BYTES / 1e9:.3g} GB each: lower batch_length, or cut out a part')


class Outcome(Enum):
    """What became of a frame."""

    ACCEPTED = 'accepted'
    REFUSED = 'refused'
    WAITING = 'waiting'
    GAP = 'gap'
    JUMP_BACK = 'jump_back'
    SIZE_CHANGE = 'size_change'


@dataclass(frozen=True)
class Intake:
    """Answer of :meth:`SlidingWindow.add`.

    Attributes
    ----------
    outcome : Outcome
        ``REFUSED`` leaves the window as it was; ``GAP``, ``JUMP_BACK`` and ``SIZE_CHANGE`` start
        it again with this frame, ``JUMP_BACK`` with the one before as well. ``WAITING`` is a
        stamp before all that are held: the next frame tells whether it alone is wrong.
    batch : FrameBatch or None
        Frames to search now. When the window was started again this is the full window of
        before, if some of its frames were in no batch yet.
    reason : str
        What was expected and what was found; empty for an accepted frame.
    left_out : str
        Why the frame that was waiting is left out; empty when none is.
    """

    outcome: Outcome
    batch: FrameBatch | None = None
    reason: str = ''
    left_out: str = ''


class SlidingWindow:
    """Hold the newest frames and release them as a batch every ``hop`` frames.

    Parameters
    ----------
    length : int
        Frames in a batch; no more are ever held.
    hop : int
        New frames from one batch to the next, at most ``length``.
    max_gap_s : float, optional
        Longest pause between two frames of a batch, in seconds. Automatic is the duration of
        ``length`` median intervals.
    several : bool
        Whether the frames are those of several sensors, already in order: stamps may repeat, and
        intervals differ by rule, so that a gap is known by their mean once many are.
    """

    def __init__(self, length: int, hop: int, max_gap_s: float | None = None,
                 several: bool = False):
        if length < 1:
            raise ParameterError(f'the length of a window must be at least 1 frame, got {length}')
        if not 1 <= hop <= length:
            raise ParameterError(
                f'hop must be from 1 to the length of the window ({length}), got {hop}')
        if max_gap_s is not None and not max_gap_s > 0.0:
            raise ParameterError(f'max_gap_s must be above 0 s, got {max_gap_s:g}')
        self.length = length
        self.hop = hop
        self.max_gap_s = max_gap_s
        self._several = several
        self._frames: deque[NDArray] = deque(maxlen=length)
        self._stamps: deque[float] = deque(maxlen=length)
        self._indices: deque[int] = deque(maxlen=length)
        self._intervals: deque[float] = deque(maxlen=max(length, 20))
        self._n_new = 0
        self._waiting: tuple[NDArray, float, int] | None = None
        # Increasing stamps in turn between the oldest and the newest held one, the last of them.
        self._n_between, self._last_between_s = 0, 0.0

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def n_new(self) -> int:
        """Number of held frames that no batch has contained."""
        return min(self._n_new, len(self._frames))

    @property
    def shape(self) -> tuple[int, int] | None:
        """Height and width of the held frames, None while there is none."""
        return self._frames[-1].shape if self._frames else None

    @property
    def median_interval_s(self) -> float | None:
        """Median time between recent frames in seconds, None before the second one."""
        return float(np.median(self._intervals)) if self._intervals else None

    def add(self, pixels: NDArray, stamp_s: float, frame_index: int) -> Intake:
        """Take one frame.

        Parameters
        ----------
        pixels : array, shape (H, W)
            Kept as it is, not copied.
        stamp_s : float
            Time in seconds. A stamp that repeats, or that lies between the oldest and the newest
            held one, is refused; two earlier ones in turn start the window again (a looped
            recording), a single one is left out. So do more frames in turn between than are held:
            of these the newest has an odd stamp.
        frame_index : int
            Number of the frame in its stream, larger than that of the frame before.
        """
        waiting, self._waiting = self._waiting, None
        intake = self._add(pixels, stamp_s, frame_index, waiting)
        if waiting is None or intake.outcome is Outcome.JUMP_BACK:
            return intake
        return replace(intake, left_out=(
            f'a frame stamped {waiting[1]:.6f} s between later ones is left out'))

    def _add(self, pixels: NDArray, stamp_s: float, frame_index: int,
             waiting: tuple[NDArray, float, int] | None) -> Intake:
        if not self._frames:
            return self._accept(Outcome.ACCEPTED, pixels, stamp_s, frame_index)
        newest, oldest = self._stamps[-1], self._stamps[0]
        if stamp_s == newest and not self._several:
            return Intake(Outcome.REFUSED, reason=(
                f'expected a stamp after {newest:.6f} s, found the same one again '
                '(is header.stamp filled in?)'))
        if pixels.shape != self._frames[-1].shape:
            reason = (f'expected frames of {_size(self._frames[-1].shape)}, found '
                      f'{_size(pixels.shape)}')
            return self._restart(Outcome.SIZE_CHANGE, reason, pixels, stamp_s, frame_index)
        if stamp_s < newest:
            goes_on = waiting is not None and (
                waiting[1] < stamp_s or self._several and waiting[1] == stamp_s)
            if stamp_s > oldest and not goes_on and self._held_outweigh(stamp_s):
                return Intake(Outcome.REFUSED, reason=(
                    f'expected a stamp after {newest:.6f} s, found one '
                    f'{newest - stamp_s:.6f} s earlier'))
            reason = (f'expected a stamp after {newest:.6f} s, found a jump back by '
                      f'{newest - stamp_s:.6f} s')
            if waiting is None or not goes_on:
                self._waiting = pixels, stamp_s, frame_index
                return Intake(Outcome.WAITING, reason=reason)
            first = self._restart(Outcome.JUMP_BACK, reason, *waiting)
            second = self._accept(Outcome.JUMP_BACK, pixels, stamp_s, frame_index)
            return replace(first, batch=second.batch or first.batch)
        longest = self._longest_gap()
        if longest is not None and stamp_s - newest > longest:
            reason = (f'expected a frame within {longest:.6g} s, found a gap of '
                      f'{stamp_s - newest:.6g} s')
            return self._restart(Outcome.GAP, reason, pixels, stamp_s, frame_index)
        first_gap = self._first_gap(stamp_s - newest)
        if first_gap is not None:
            return self._accept_after_first_gap(first_gap, pixels, stamp_s, frame_index)
        return self._accept(Outcome.ACCEPTED, pixels, stamp_s, frame_index)

    def flush(self) -> FrameBatch | None:
        """Return the held frames if some were in no batch yet, else None; they stay held."""
        return self._release() if self._n_new else None

    def clear(self) -> None:
        """Forget every frame."""
        self._frames.clear()
        self._stamps.clear()
        self._indices.clear()
        self._intervals.clear()
        self._n_new = 0

    def _held_outweigh(self, stamp_s: float) -> bool:
        """Count a stamp between those held; return whether fewer came in turn than are held."""
        self._n_between = self._n_between + 1 if stamp_s > self._last_between_s else 1
        self._last_between_s = stamp_s
        return self._n_between < len(self._frames)

    def _longest_gap(self) -> float | None:
        if self.max_gap_s is not None:
            return self.max_gap_s
        if self._several:
            known = len(self._intervals) == self._intervals.maxlen
            return self.length * float(np.mean(self._intervals)) if known else None
        # A single interval may itself be the gap.
        if len(self._intervals) < 2:
            return None
        return self.length * float(np.median(self._intervals))

    def _first_gap(self, interval_s: float) -> float | None:
        """Return the first interval when the second one shows that it was a gap, else None.

        A camera whose first stamp is zero, or from before its clock was set, is an example.
        """
        if self.max_gap_s is not None or self._several or len(self._intervals) != 1:
            return None
        first = self._intervals[0]
        longest = max(SHORTEST_FIRST_GAP_S, self.length * interval_s)
        return first if first > longest else None

    def _accept_after_first_gap(self, gap_s: float, pixels: NDArray, stamp_s: float,
                                frame_index: int) -> Intake:
        """Forget what lies before the gap, then take the frame."""
        while len(self._frames) > 1:
            self._frames.popleft()
            self._stamps.popleft()
            self._indices.popleft()
        self._intervals.clear()
        self._n_new = min(self._n_new, 1)
        reason = (f'found a gap of {gap_s:.6g} s before the second frame, '
                  f'{stamp_s - self._stamps[-1]:.6g} s after it the third')
        batch = self._accept(Outcome.GAP, pixels, stamp_s, frame_index).batch
        return Intake(Outcome.GAP, batch, reason)

    def _restart(self, outcome: Outcome, reason: str, pixels: NDArray, stamp_s: float,
                 frame_index: int) -> Intake:
        # A part of a window would have to be calibrated for its own length, while frames arrive.
        tail = self.flush() if len(self._frames) == self.length else None
        self.clear()
        first = self._accept(outcome, pixels, stamp_s, frame_index).batch
        # Only a window of one frame has a batch due at once; it never leaves a tail.
        return Intake(outcome, tail if first is None else first, reason)

    def _accept(self, outcome: Outcome, pixels: NDArray, stamp_s: float,
                frame_index: int) -> Intake:
        self._n_between = 0
        if self._stamps:
            self._intervals.append(stamp_s - self._stamps[-1])
        self._frames.append(pixels)
        self._stamps.append(float(stamp_s))
        self._indices.append(int(frame_index))
        self._n_new += 1
        due = len(self._frames) == self.length and self._n_new >= self.hop
        return Intake(outcome, self._release() if due else None)

    def _release(self) -> FrameBatch:
        self._n_new = 0
        return FrameBatch(np.stack(list(self._frames)), np.array(self._stamps),
                          np.array(self._indices, np.int64))


def _size(shape: tuple[int, int]) -> str:
    height, width = shape
    return f'{height} x {width} (height x width)'
