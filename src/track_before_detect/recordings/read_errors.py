"""What libraries raise or say about damaged files becomes one sentence, nothing stays open."""

from collections.abc import Iterator
from contextlib import contextmanager
import importlib
import logging
import re
import struct
from types import ModuleType
from typing import Protocol
import zlib

from track_before_detect.errors import DataError, MissingExtraError

# What damaged files raise in the image libraries.
IMAGE_ERRORS = (OSError, EOFError, ValueError, TypeError, IndexError, KeyError, SyntaxError,
                RuntimeError, struct.error, zlib.error)

_PACKAGE = 'track_before_detect'
# What Python puts before the words of a warning: file, line and class.
_BEFORE_WARNING = re.compile(r'.*?([^/\\\s]+)\.py:\d+: (\w+): ')


class Closable(Protocol):
    """A file, or what reads from one."""

    def close(self) -> None:
        """Close the file."""


@contextmanager
def read_errors(message: str, errors: tuple[type[Exception], ...]) -> Iterator[None]:
    """Raise DataError, beginning with a message, for the errors of a library."""
    try:
        yield
    except DataError:
        raise
    except errors as error:
        # The first line says what is wrong, without the number and the path that the system's
        # errors have around it; an error without words has a name at least.
        said = getattr(error, 'strerror', None) or str(error).strip() or type(error).__name__
        reason = said.splitlines()[0]
        raise DataError(f'{message}: {reason}') from error


def reader_module(module: str, package: str, what: str, extra: str = 'readers',
                  doing: str = 'reading') -> ModuleType:
    """Return the module of an optional package that reads something, and comes with an extra."""
    try:
        imported = importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{doing} {what} needs {package}: pip install 'track_before_detect[{extra}]'"
        ) from error
    # Some log what they find odd in a file straight to the terminal.
    logging.getLogger(module.partition('.')[0]).addFilter(_GATHERING)
    return imported


def said_by_library(record: logging.LogRecord) -> str:
    """Return what was logged, or warned of, as one line that names who says it."""
    words = ' '.join(record.getMessage().split('\n  ')[0].split())
    warned = _BEFORE_WARNING.match(words)
    if record.name == 'py.warnings' and warned is not None:
        return f'{words[warned.end():]} ({warned[2]} of {warned[1]})'
    library = record.name.partition('.')[0]
    return words if library == _PACKAGE else f'{words} (says {library})'


class _Gathering(logging.Filter):
    """Keeps warnings from their way while somebody gathers them."""

    def __init__(self) -> None:
        super().__init__()
        self.gatherers: list[list[str]] = []

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record goes on its way."""
        if record.levelno < logging.WARNING or not self.gatherers:
            return True
        self.gatherers[-1].append(' '.join(record.getMessage().split()))
        return False


_GATHERING = _Gathering()


@contextmanager
def gathered_warnings() -> Iterator[list[str]]:
    """Yield what the libraries that read files say of them meanwhile, which nobody else hears."""
    words: list[str] = []
    _GATHERING.gatherers.append(words)
    try:
        yield words
    finally:
        # Not by value: what another thread gathers meanwhile may say the same, or nothing yet.
        _GATHERING.gatherers[:] = [others for others in _GATHERING.gatherers
                                   if others is not words]


@contextmanager
def closed_on_error(file: Closable) -> Iterator[None]:
    """Close a file when the block does not end well."""
    try:
        yield
    except BaseException:
        file.close()
        raise
