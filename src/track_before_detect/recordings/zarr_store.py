"""Recordings in Zarr: a folder or a zip file of chunks, of which those in need are read."""

from pathlib import Path
from typing import Any
import zipfile

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.recordings.npz import check_layout
from track_before_detect.recordings.read_errors import closed_on_error, read_errors, reader_module
from track_before_detect.recordings.recording import CACHE_BYTES, Recording

_READ_ERRORS = (OSError, ValueError, KeyError, TypeError, RuntimeError, EOFError)
_MARKS = ('zarr.json', '.zarray', '.zgroup')


def is_zarr(path: Path) -> bool:
    """Return whether a path is a folder of Zarr, of version 2 or 3, or a zip file."""
    if path.is_dir():
        return any((path / mark).exists() for mark in _MARKS)
    return path.suffix.lower() == '.zip'


def open_zarr(path: Path) -> Recording:
    """Open an array (T, H, W), or a group of ``frames`` and optional ``stamps``, ``truth``."""
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
            stamps, truth = (np.asarray(parts[name][...]) if name in parts else None
                             for name in ('stamps', 'truth'))
            return Recording(path.name, frames.shape[1:], frames.dtype, frames.shape[0],
                             _ZarrSource(path, store, frames), stamps, truth)


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
