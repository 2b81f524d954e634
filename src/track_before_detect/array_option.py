"""Arrays as values of options: given in Python, or as the name of a file."""

import hashlib
import os
from pathlib import Path
import tokenize
from typing import Any
import zipfile
import zlib

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError, TbdError
from track_before_detect.recordings.images import IMAGE_SUFFIXES, read_image

_ARCHIVE_ERRORS = (OSError, EOFError, ValueError, KeyError, SyntaxError, tokenize.TokenError,
                   zipfile.BadZipFile, zlib.error)


class ArrayOption:
    """An array that compares by its content and is written as its source.

    Parameters
    ----------
    array : array
        Copied, and read-only from then on.
    source : str
        Name of the file it came from; empty for an array of Python.
    """

    def __init__(self, array: Any, source: str = ''):
        self.array: NDArray = np.array(array)
        self.array.flags.writeable = False
        self.source = source

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ArrayOption):
            return NotImplemented
        return (self.array.dtype == other.array.dtype
                and np.array_equal(self.array, other.array))

    def __hash__(self) -> int:
        return hash((self.array.shape, hashlib.sha256(self.array.tobytes()).digest()))

    def __str__(self) -> str:
        return self.source or f'array of shape {self.array.shape}'

    def __repr__(self) -> str:
        return f'<{self}>'


def array_option(name: str, value: Any) -> ArrayOption:
    """Return the array an option was given.

    Parameters
    ----------
    name : str
        Of the option; also the first array looked for in an archive.
    value : array, path or ArrayOption
        Numbers, or the name of a .npy or .npz file or of an image.

    Raises
    ------
    ParameterError
        When there is no array of numbers.
    """
    if isinstance(value, ArrayOption):
        return value
    source = ''
    if isinstance(value, (str, os.PathLike)):
        source = os.fspath(value)
        value = _read(name, Path(source))
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.empty(0, object)
    if array.dtype.kind not in 'biuf' or array.ndim == 0:
        raise ParameterError(f'{name} must be an array of real numbers, or the name of a file '
                             f'with one, got {source or type(value).__name__}')
    return ArrayOption(array, source)


def _read(name: str, path: Path) -> Any:
    suffix = path.suffix.lower()
    try:
        if suffix in IMAGE_SUFFIXES:
            return read_image(path)
        if suffix not in ('.npy', '.npz'):
            raise ParameterError(
                f'{name} must be a file of type .npy, .npz or {", ".join(IMAGE_SUFFIXES)}, got '
                f'{path}')
        with open(path, 'rb') as file:
            content = np.load(file, allow_pickle=False)
            # What is in the file tells, not its name.
            if isinstance(content, np.ndarray):
                return content
            with content as archive:
                return archive[_name_in(archive.files, name, path)]
    except ParameterError:
        raise
    except TbdError as error:
        raise ParameterError(f'{name} cannot be used: {error}') from error
    except _ARCHIVE_ERRORS as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ParameterError(f'{name} cannot be read from {path}: {reason}') from error


def _name_in(names: list[str], name: str, path: Path) -> str:
    """Return the name of the array to take from an archive."""
    if name in names:
        return name
    if len(names) == 1:
        return names[0]
    raise ParameterError(f'{path} must hold an array {name!r} or a single one, found '
                         f'{", ".join(names) or "none"}')
