"""SIGINT and SIGTERM end an executable within two seconds, whatever it is doing.

Imports next to nothing: it has to be there before all that takes a second to import.
"""

from collections.abc import Callable
import os
import signal
import sys
import threading
import time
from typing import Any, NoReturn

# What is left of two seconds for the process to end by itself.
GRACE_S = 1.5


class Ending:
    """Waits for a signal in a thread of its own; the main thread is not interrupted by it.

    Until :meth:`hold` is called the process ends at once, for nothing has to be put away. Further
    signals change nothing: under ``ros2 launch`` Ctrl-C arrives twice.

    Parameters
    ----------
    code : int
        Exit code of the process when a signal ended it.
    grace_s : float
        Time from the first signal to the end of the process at the latest.

    Attributes
    ----------
    requested : bool
        Whether a signal has come.
    """

    def __init__(self, code: int = 0, grace_s: float = GRACE_S):
        self.requested = False
        self._code = code
        self._grace_s = grace_s
        self._lock = threading.Lock()
        self._holding = False
        self._wake: Callable[[], None] = _nothing
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        # Written to at once, while a handler has to wait until the main thread leaves a library.
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _nothing)
        threading.Thread(target=self._watch, args=(reader,), name='ending', daemon=True).start()

    def hold(self, wake: Callable[[], None] | None = None) -> None:
        """Let a signal set :attr:`requested` from now on, and call ``wake`` in another thread."""
        with self._lock:
            self._holding = True
            self._wake = wake or self._wake
            if self.requested:
                self._wake()

    def leave(self, code: int) -> NoReturn:
        """End the process, all being put away.

        Python's own end would let go of the signals first, so that a second one made itself felt,
        and it crashes under a compilation, which cannot be interrupted.
        """
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

    def _watch(self, reader: int) -> None:
        while os.read(reader, 1)[0] not in (signal.SIGINT, signal.SIGTERM):
            pass
        with self._lock:
            if not self._holding:
                os._exit(self._code)
            self.requested = True
            self._wake()
        time.sleep(self._grace_s)
        os._exit(self._code)


def _nothing(*_: Any) -> None:
    pass
