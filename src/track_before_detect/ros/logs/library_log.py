"""What the library says through Python's logging and warnings, handed to a node."""

from collections.abc import Callable
import logging
from typing import ClassVar
import warnings

from track_before_detect.recordings.read_errors import said_by_library

# Ours, and what logging makes of Python's warnings.
_NAMES = ('track_before_detect', 'py.warnings')


class LibraryLog(logging.Handler):
    """Hands warnings of the library on until it is closed.

    With the last one that is closed Python's warnings go where they went before.

    Parameters
    ----------
    warn : callable
        Takes a kind, for throttling, and a sentence.
    """

    _open: ClassVar[set['LibraryLog']] = set()
    _captures: ClassVar[bool] = False

    def __init__(self, warn: Callable[[str, str], None]) -> None:
        super().__init__(logging.WARNING)
        self._warn = warn
        if not self._open:
            before = warnings.showwarning
            logging.captureWarnings(True)
            # Otherwise somebody else had it done, who may go on.
            LibraryLog._captures = warnings.showwarning is not before
        self._open.add(self)
        for name in _NAMES:
            logging.getLogger(name).addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Hand one record on."""
        text = said_by_library(record)
        if record.exc_info:
            text = f'{text}\n{logging.Formatter().formatException(record.exc_info)}'
        self._warn(f'{record.name}: {record.msg}', text)

    def close(self) -> None:
        """Hand on no more."""
        for name in _NAMES:
            logging.getLogger(name).removeHandler(self)
        self._open.discard(self)
        if self._captures and not self._open:
            logging.captureWarnings(False)
            LibraryLog._captures = False
        super().close()
