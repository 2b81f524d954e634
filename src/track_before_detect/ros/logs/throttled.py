"""Lines of a log, of which a flood is thinned out."""

from collections import deque
from collections.abc import Callable
import threading
import time

MOST_LINES, PERIOD_S = 10, 5.0


class ThrottledLog:
    """Lets a number of lines through in any period; of more the last, once there is room again.

    Parameters
    ----------
    log : callable
        Takes a line.
    most_lines : int
        In a period.
    period_s : float
        Its length.
    """

    def __init__(self, log: Callable[[str], None], most_lines: int = MOST_LINES,
                 period_s: float = PERIOD_S) -> None:
        self._log = log
        self._period_s = period_s
        self._logged_s = deque([float('-inf')] * most_lines, most_lines)
        self._held, self._n_held = '', 0
        self._lock = threading.Lock()

    def __call__(self, line: str) -> None:
        """Log a line, or hold it in place of one that is held."""
        with self._lock:
            self._held, self._n_held = line, self._n_held + 1
        self.catch_up()

    def catch_up(self) -> None:
        """Log the line that is held, if there is one and room for it."""
        with self._lock:
            now_s = time.monotonic()
            if not self._n_held or now_s - self._logged_s[0] < self._period_s:
                return
            self._logged_s.append(now_s)
            left_out = f' ({self._n_held - 1} lines left out before)' * (self._n_held > 1)
            line, self._n_held = self._held + left_out, 0
        self._log(line)
