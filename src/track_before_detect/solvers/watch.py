"""How long a batch may be searched, and a sign of life while it is."""

import math
import time

from track_before_detect.types import Progress

# Between two signs of life, in seconds.
PERIOD_S = 0.5


class Watch:
    """Keeps the time of one batch; whatever takes long asks it before each step.

    Parameters
    ----------
    limit_s : float, optional
        Seconds from now after which the search has to end; unlimited unless given.
    progress : callable, optional
        Told of the search, whenever the watch is asked and the last time is a while ago.

    Attributes
    ----------
    is_limited, stopped : bool
        Whether the time will be up, and whether somebody was told that it is.
    """

    def __init__(self, limit_s: float | None = None, progress: Progress | None = None):
        self.is_limited = limit_s is not None
        self._limit_s = math.inf if limit_s is None else limit_s
        self._progress = progress
        self._begun_s = self._told_s = time.monotonic()
        self._share, self._stage_end = 0.0, 1.0
        self.stopped = False

    def begin_stage(self, number: int, n_stages: int) -> None:
        """Note for the progress which part of the search begins, counted from 0."""
        self._share, self._stage_end = number / n_stages, (number + 1) / n_stages

    def end_round(self) -> None:
        """Note for the progress that a round of a stage is done; how many come is not known."""
        self._share = 0.5 * (self._share + self._stage_end)

    def time_is_up(self) -> bool:
        """Return whether the search has to end now."""
        now_s = time.monotonic()
        if self._progress is not None and now_s - self._told_s >= PERIOD_S:
            self._told_s = now_s
            self._progress('searching', max(
                self._share, min((now_s - self._begun_s) / self._limit_s, 1.0)))
        if now_s - self._begun_s >= self._limit_s:
            self.stopped = True
        return self.stopped

    def status(self, otherwise: str) -> str:
        """Return the status of the batch, which is another one if the time sufficed."""
        return 'time_limit' if self.stopped else otherwise
