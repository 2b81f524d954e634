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
        """Return whether a frame (H, W) repeats the one before, itself a repeat or not."""
        last, self._last = self._last, frame
        return last is not None and last.shape == frame.shape and self.is_one(change(last, frame))

    def is_one(self, changed: float) -> bool:
        """Return whether the next frame is a repeat, told how much changed; see :func:`change`."""
        usual = float(np.median(self._changes)) if self._changes else 0.0
        if usual >= NOISY and changed <= LEAST_CHANGE * usual:
            self.count += 1
            return True
        if changed > 0:
            self._changes.append(changed)
        return False


def change(last: NDArray, frame: NDArray) -> float:
    """Return the share of the pixels that differ from those of the frame before."""
    # A masked pixel differs from itself, so a frame without data repeats nothing.
    return float(np.mean(frame != last))
