"""Recordings in NumPy archives, read and written."""

from __future__ import annotations

import math
import os
from pathlib import Path
import tokenize
from typing import IO
import zipfile
import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.atomic_files import atomic_path
from track_before_detect.checks import check_axes
from track_before_detect.errors import DataError
from track_before_detect.recordings.read_errors import closed_on_error, read_errors
from track_before_detect.recordings.recording import MappedSource, Recording

# What damaged or foreign archives raise in zipfile, zlib and numpy.lib.format, which hands the
# headers of arrays to tokenize.
_READ_ERRORS = (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, SyntaxError,
                tokenize.TokenError, NotImplementedError, RuntimeError)
_SKIP_BYTES = 2**20
# Of stamps or truth: zeros without end pack to next to nothing.
_MOST_VALUES = 10**7


def open_npz(path: Path) -> Recording:
    """Open an archive with ``frames`` (T, H, W) and optional ``stamps``, ``fps``, ``truth``."""
    if path.stat().st_size == 0:
        raise DataError(f'{path} is empty')
    with read_errors(f'{path} is not a complete .npz archive', _READ_ERRORS):
        archive = zipfile.ZipFile(path)
    with closed_on_error(archive):
        names = {name[:-4] for name in archive.namelist() if name.endswith('.npy')}
        if 'frames' not in names:
            found = ', '.join(sorted(names)) or 'no arrays'
            raise DataError(f"{path} must hold an array 'frames' (T, H, W), found {found}")
        with read_errors(f"array 'frames' of {path} cannot be read", _READ_ERRORS):
            source = _NpzSource(path, archive)
        with closed_on_error(source):
            return _recording(path, archive, names, source)


def open_npy(path: Path) -> Recording:
    """Open an array (T, H, W) in a file of its own."""
    if path.stat().st_size == 0:
        raise DataError(f'{path} is empty')
    with read_errors(f'{path} is not a complete .npy array', _READ_ERRORS):
        frames = np.load(path, mmap_mode='r', allow_pickle=False)
    if not isinstance(frames, np.ndarray):
        frames.close()
        raise DataError(f'{path} must be an array, found an archive: give it a name that ends '
                        'with .npz')
    check_layout(f'array of {path}', frames.shape, frames.dtype)
    return Recording(path.name, frames.shape[1:], frames.dtype, len(frames), MappedSource(frames))


def write_npz_recording(path: str | os.PathLike, frames: ArrayLike, stamps: ArrayLike,
                        truth: ArrayLike | None = None) -> None:
    """Write a recording that :func:`~.open_recording.open_recording` reads.

    Parameters
    ----------
    path : path
        Ends with ``.npz``.
    frames : array, shape (T, H, W)
    stamps : array, shape (T,)
        Seconds.
    truth : array, shape (N, 4), optional
        Rows [frame, id, x, y].
    """
    rows = np.zeros((0, 4)) if truth is None else np.asarray(truth)
    with atomic_path(path) as partial, open(partial, 'wb') as file:
        # Noise hardly compresses, and stored frames are read much faster.
        np.savez(file, frames=np.asarray(frames), stamps=np.asarray(stamps), truth=rows)


def _recording(path: Path, archive: zipfile.ZipFile, names: set[str],
               source: _NpzSource) -> Recording:
    n_frames, height, width = source.shape
    stamps = None
    if 'stamps' in names:
        stamps = _whole_array(path, archive, 'stamps')
    elif 'fps' in names:
        stamps = stamps_of_rate(path, _whole_array(path, archive, 'fps'), n_frames)
    truth = _whole_array(path, archive, 'truth') if 'truth' in names else None
    return Recording(path.name, (height, width), source.dtype, n_frames, source, stamps, truth,
                     unit_known='stamps' not in names)


def stamps_of_rate(path: Path, fps: NDArray, n_frames: int) -> NDArray[np.float64]:
    """Return stamps that are 1/``fps`` seconds apart; refuse what is not one positive number."""
    if fps.size != 1 or fps.dtype.kind not in 'iuf' or not 0 < float(fps.item()) < np.inf:
        raise DataError(f"'fps' of {path} must be one positive number, got {fps!r}")
    with np.errstate(over='ignore'):
        return np.arange(n_frames) / float(fps.item())


def _whole_array(path: Path, archive: zipfile.ZipFile, name: str,
                 most_values: float = _MOST_VALUES) -> NDArray:
    """Return a whole array of the archive, if it holds no more than it may."""
    with (read_errors(f'array {name!r} of {path} cannot be read', _READ_ERRORS),
          archive.open(f'{name}.npy') as file):
        shape, _, dtype = _read_header(file)
        _check_size(path, archive, name, shape, dtype, file.tell())
        if math.prod(shape) > most_values:
            raise DataError(f'array {name!r} of {path} must hold at most {most_values} values, '
                            f'got shape {shape}')
        file.seek(0)
        return np.lib.format.read_array(file, allow_pickle=False)


class _NpzSource:
    """Streams the array ``frames`` forwards; a step back opens the member again."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path = path
        self._archive = archive
        self._member = archive.open('frames.npy')
        with closed_on_error(self._member):
            self._read_layout()

    def _read_layout(self) -> None:
        self.shape, fortran_order, self.dtype = _read_header(self._member)
        path = self._path
        check_layout(f"array 'frames' of {path}", self.shape, self.dtype)
        _check_size(path, self._archive, 'frames', self.shape, self.dtype, self._member.tell())
        self._next = 0
        self._is_scattered = fortran_order
        self._whole: NDArray | None = None

    def read(self, index: int) -> NDArray:
        if self._is_scattered:
            # A frame lies all over the file, which is read when the first is asked for.
            if self._whole is None:
                self._whole = _whole_array(self._path, self._archive, 'frames', math.inf)
            return np.array(self._whole[index], order='C')
        n_bytes = self.shape[1] * self.shape[2] * self.dtype.itemsize
        with read_errors(f'frame {index} of {self._path} cannot be read', _READ_ERRORS):
            if index < self._next:
                self._member.close()
                self._member = self._archive.open('frames.npy')
                _read_header(self._member)
                self._next = 0
            self._skip((index - self._next) * n_bytes)
            data = _read_exactly(self._member, n_bytes)
        self._next = index + 1
        return np.frombuffer(data, self.dtype).reshape(self.shape[1:]).astype(
            self.dtype.newbyteorder('='))

    def _skip(self, n_bytes: int) -> None:
        while n_bytes > 0:
            n_bytes -= len(_read_exactly(self._member, min(n_bytes, _SKIP_BYTES)))

    def close(self) -> None:
        self._member.close()
        self._archive.close()


def _read_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, Fortran order and type of the array that starts here."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(file)
    raise DataError(f'.npy format version {version[0]}.{version[1]} is not for plain numbers')


def check_layout(name: str, shape: tuple[int, ...], dtype: np.dtype) -> None:
    """Refuse an array that holds no frames."""
    if dtype.hasobject or dtype.kind not in 'iufc':
        raise DataError(f'{name} must be numbers (T, H, W), got type {dtype}')
    if len(shape) != 3:
        what = 'a single image' if len(shape) == 2 else f'{len(shape)} dimensions'
        raise DataError(f'{name} must be (T, H, W), got {what} of shape {shape}')
    check_axes(shape, name)


def _check_size(path: Path, archive: zipfile.ZipFile, name: str, shape: tuple[int, ...],
                dtype: np.dtype, header_bytes: int) -> None:
    """Refuse an array that its member does not hold, before memory is asked for it."""
    n_bytes = math.prod(shape) * dtype.itemsize
    held = archive.getinfo(f'{name}.npy').file_size - header_bytes
    if not dtype.hasobject and not (min(shape, default=0) >= 0 and n_bytes <= held):
        raise DataError(
            f'array {name!r} of {path} cannot be read: shape {shape} of {dtype} needs {n_bytes} '
            f'bytes, got {held}')


def _read_exactly(file: IO[bytes], n_bytes: int) -> bytes:
    """Return ``n_bytes`` bytes; the archive ending before is an error."""
    parts = []
    missing = n_bytes
    while missing:
        part = file.read(missing)
        if not part:
            raise EOFError(f'the array ends {missing} bytes too early')
        parts.append(part)
        missing -= len(part)
    return b''.join(parts)
