"""Where in a recording playing is, and when its next frame is due."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Playhead:
    """Goes from frame to frame as time passes, unless it is paused.

    Times are of a steady clock, in seconds; positions are seconds from the first frame.

    Parameters
    ----------
    positions : array, shape (T,)
        Of the frames, never decreasing.
    interval_s : float
        From the last frame to the first of another round.
    paused : bool
        Whether to begin so.

    Attributes
    ----------
    next : int
        Number of the frame that comes next.
    paused : bool
        Whether no frame is due until :meth:`resume`.
    rate : float
        Positions passed in a second.
    """

    def __init__(self, positions: NDArray[np.float64], interval_s: float,
                 paused: bool = False) -> None:
        self._positions, self._interval_s = positions, interval_s
        self._first, self._stop = 0, len(positions)
        self._n_left = math.inf
        self._anchor_s = self._anchor_position_s = 0.0
        self.next, self.paused, self.rate = 0, paused, 1.0

    @property
    def is_over(self) -> bool:
        """Whether the last frame was passed."""
        return self.next >= self._stop

    def frames_between(self, start_s: float, stop_s: float) -> tuple[int, int]:
        """Return the number of the first frame from ``start_s`` on and of that after ``stop_s``.

        Both include frames at these positions, rounded to a microsecond.
        """
        microseconds = np.rint(1e6 * self._positions)
        return (int(np.searchsorted(microseconds, np.rint(1e6 * start_s))),
                int(np.searchsorted(microseconds, np.rint(1e6 * stop_s), 'right')))

    def limit(self, first: int, stop: int, now_s: float) -> None:
        """Play from frame ``first`` to before ``stop`` only."""
        self._first, self._stop = first, stop
        if self.next < first:
            self.seek(first, now_s)

    def position_s(self, now_s: float) -> float:
        """Return the position at a time, not beyond the next frame."""
        passed_s = 0.0 if self.paused else self.rate * (now_s - self._anchor_s)
        return min(self._anchor_position_s + passed_s,
                   float(self._positions[min(self.next, self._stop - 1)]))

    def times_s(self, positions_s: ArrayLike) -> NDArray[np.float64]:
        """Return when positions are, or would have been, passed at this rate without a pause."""
        return self._anchor_s + (np.asarray(positions_s) - self._anchor_position_s) / self.rate

    def due_s(self) -> float:
        """Return when the next frame is due, infinite while paused."""
        return math.inf if self.paused else float(self.times_s(self._positions[self.next]))

    def pass_frame(self, now_s: float) -> None:
        """Go on to the frame after the next; pause at the last of those asked for."""
        self._n_left -= 1
        if not self._n_left:
            self.seek(self.next, now_s)
            self.paused = True
        self.next += 1

    def pause(self, now_s: float) -> None:
        """Stand still from ``now_s`` on."""
        self._move(self.position_s(now_s), now_s)
        self.paused = True

    def resume(self, now_s: float) -> None:
        """Go on from where it stands."""
        self._move(self.position_s(now_s), now_s)
        self.paused, self._n_left = False, math.inf

    def play_next(self, n_frames: int, now_s: float) -> None:
        """Play a number of frames, the first of them at once, then pause."""
        self.seek(self.next, now_s)
        self.paused, self._n_left = False, n_frames

    def seek(self, frame: int, now_s: float) -> None:
        """Let a frame be the next, due at once."""
        self.next = frame
        self._move(float(self._positions[frame]), now_s)

    def set_rate(self, rate: float, now_s: float) -> None:
        """Pass ``rate`` seconds of positions in a second from ``now_s`` on."""
        self._move(self.position_s(now_s), now_s)
        self.rate = rate

    def start_again(self, now_s: float) -> None:
        """Go back to the first frame, which is due one interval after the last one was."""
        end_s = float(self.times_s(self._positions[self._stop - 1] + self._interval_s))
        self.seek(self._first, now_s if self.paused else end_s)

    def _move(self, position_s: float, now_s: float) -> None:
        self._anchor_position_s, self._anchor_s = position_s, now_s
