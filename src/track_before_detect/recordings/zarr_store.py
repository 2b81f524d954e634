"""Recordings in Zarr: a folder or a zip file of chunks, read and written a few at a time."""

from collections.abc import Iterable
from contextlib import closing
from itertools import chain, islice
import os
from pathlib import Path
from typing import Any
import zipfile
import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.atomic_files import atomic_path
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.recordings.npz import check_layout, stamps_of_rate
from track_before_detect.recordings.read_errors import closed_on_error, read_errors, reader_module
from track_before_detect.recordings.recording import CACHE_BYTES, Recording

_READ_ERRORS = (OSError, ValueError, KeyError, TypeError, RuntimeError, EOFError,
                zipfile.BadZipFile, zlib.error)
# Of one chunk: 32 frames of 256 x 256 float32.
CHUNK_BYTES = 2**23
_MARKS = ('zarr.json', '.zarray', '.zgroup')


def is_zarr(path: Path) -> bool:
    """Return whether a path is a folder of Zarr, of version 2 or 3, or a zip file."""
    if path.is_dir():
        return any((path / mark).exists() for mark in _MARKS)
    return path.suffix.lower() == '.zip'


def open_zarr(path: Path) -> Recording:
    """Open an array (T, H, W), or a group of ``frames`` and what else a ``.npz`` may hold."""
    zarr = reader_module('zarr', 'zarr', 'Zarr', 'zarr')
    if path.is_file() and not zipfile.is_zipfile(path):
        raise DataError(f'{path} is no complete Zarr: it is no zip file')
    with read_errors(f'{path} is no complete Zarr', _READ_ERRORS):
        store = (zarr.storage.LocalStore if path.is_dir() else zarr.storage.ZipStore)(
            path, read_only=True)
        with closed_on_error(store):
            node = zarr.open(store, mode='r')
            parts = {'frames': node} if isinstance(node, zarr.Array) else dict(node.arrays())
            if 'frames' not in parts:
                found = ', '.join(sorted(parts)) or 'no arrays'
                raise DataError(f"{path} must hold an array 'frames' (T, H, W), found {found}")
            frames = parts['frames']
            check_layout(f"array 'frames' of {path}", frames.shape, frames.dtype)
            stamps, truth, fps = (np.asarray(parts[name][...]) if name in parts else None
                                  for name in ('stamps', 'truth', 'fps'))
            if stamps is None and fps is not None:
                stamps = stamps_of_rate(path, fps, frames.shape[0])
            return Recording(path.name, frames.shape[1:], frames.dtype, frames.shape[0],
                             _ZarrSource(path, store, frames), stamps, truth,
                             unit_known='stamps' not in parts)


def write_zarr_recording(path: str | os.PathLike, frames: Iterable[NDArray], stamps: ArrayLike,
                         truth: ArrayLike | None = None) -> None:
    """Write a recording that is larger than memory, a few frames at a time.

    Parameters
    ----------
    path : path
        Of a folder that is not there yet; ends with ``.zip`` for a zip file.
    frames : iterable of arrays, shape (H, W)
        As many as there are stamps, each asked for when those before are written.
    stamps : array, shape (T,)
        Seconds.
    truth : array, shape (N, 4), optional
        Rows [frame, id, x, y].

    Raises
    ------
    ParameterError
        If the folder is there.
    DataError
        If there are fewer frames than stamps.
    MissingExtraError
        Without the extra ``zarr``.
    """
    zarr = reader_module('zarr', 'zarr', 'Zarr', 'zarr', 'writing')
    path, stamps = Path(path), np.asarray(stamps)
    if path.is_dir():
        raise ParameterError(f'{path} is there already: choose another name, or remove it')
    with atomic_path(path) as partial, closing(
            zarr.storage.ZipStore(partial, mode='w') if path.suffix.lower() == '.zip'
            else zarr.storage.LocalStore(partial)) as store:
        group = zarr.create_group(store)
        group.create_array('stamps', data=stamps)
        if truth is not None:
            group.create_array('truth', data=np.asarray(truth))
        frames = iter(frames)
        first = next(frames)
        span = min(max(1, CHUNK_BYTES // first.nbytes), len(stamps))
        # Noise hardly compresses.
        written = group.create_array(
            'frames', shape=(len(stamps), *first.shape), dtype=first.dtype,
            chunks=(span, *first.shape), compressors=None)
        frames, n_written = chain([first], frames), 0
        while held := list(islice(frames, span)):
            written[n_written:n_written + len(held)] = np.stack(held)
            n_written += len(held)
        if n_written != len(stamps):
            raise DataError(f'{path} must have a frame for each of {len(stamps)} stamps, got '
                            f'{n_written}')


class _ZarrSource:
    """Reads frames in spans of one chunk, so that none is unpacked for each of its frames."""

    def __init__(self, path: Path, store: Any, frames: Any) -> None:
        self._path, self._store, self._frames = path, store, frames
        frame_bytes = frames.dtype.itemsize * frames.shape[1] * frames.shape[2]
        self._span = max(1, min(frames.chunks[0], CACHE_BYTES // max(frame_bytes, 1)))
        self._first = 0
        self._held: NDArray = np.empty((0, 0, 0))

    def read(self, index: int) -> NDArray:
        """Return frame ``index``, shape (H, W)."""
        if not self._first <= index < self._first + len(self._held):
            first = index - index % self._span
            with read_errors(f'frame {index} of {self._path} cannot be read', _READ_ERRORS):
                self._held = np.asarray(self._frames[first:first + self._span])
            self._first = first
        return self._held[index - self._first].copy()

    def close(self) -> None:
        """Close the file."""
        self._store.close()
