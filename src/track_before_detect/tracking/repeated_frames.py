"""Frames that hold nothing new, as a shutter correction or too high a frame rate makes."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

# Share of the pixels that change from frame to frame, over its usual one, below which a frame
# repeats the one before: a video codec touches a few blocks of a repeated frame.
LEAST_CHANGE = 0.05
# Least usual share that tells: in a picture without noise, frames are equal until what moves comes
# to the next pixel.
NOISY = 0.1
# Frames whose change says what is usual.
REMEMBERED = 50


class RepeatedFrames:
    """Tells which frames of a stream repeat the one before.

    Attributes
    ----------
    count : int
        Frames that did so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last: NDArray | None = None
        self._changes: deque[float] = deque(maxlen=REMEMBERED)

    def repeats(self, frame: NDArray) -> bool:
        """Return whether a frame (H, W) repeats the last one that did not."""
        last, self._last = self._last, frame
        if last is None or last.shape != frame.shape:
            return False
        # A masked pixel differs from itself, so a frame without data repeats nothing.
        change = float(np.mean(frame != last))
        usual = float(np.median(self._changes)) if self._changes else 0.0
        if usual >= NOISY and change <= LEAST_CHANGE * usual:
            self.count += 1
            return True
        if change > 0:
            self._changes.append(change)
        return False
