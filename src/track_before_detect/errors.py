"""Errors this package raises on purpose."""

from collections.abc import Iterable, Mapping
import difflib
from typing import TypeVar

_Item = TypeVar('_Item')


class TbdError(Exception):
    """Root of every error raised on purpose by this package."""


class ParameterError(TbdError, ValueError):
    """An option or argument has a value that cannot be used."""


class DataError(TbdError, ValueError):
    """Input data (an array, a file, a message) cannot be used."""


class TooFewFramesError(DataError):
    """A step of preprocessing cannot do with so few frames."""


class MissingExtraError(TbdError, ImportError):
    """An optional dependency is needed for what was asked and is not installed."""


def named(kind: str, name: str, known: Mapping[str, _Item]) -> _Item:
    """Return what has a name, or say which of its kind there are."""
    if name not in known:
        raise ParameterError(f'unknown {kind} {name!r}; {suggestion(name, known)}')
    return known[name]


def suggestion(name: object, known: Iterable[str]) -> str:
    """Return what to say after a name that is not known: the nearest one, or all there are."""
    names = list(known)
    close = difflib.get_close_matches(str(name), names, n=1)
    return f'did you mean {close[0]}?' if close else f'known: {", ".join(names)}'
