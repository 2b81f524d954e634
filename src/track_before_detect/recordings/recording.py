"""A recording that is read frame by frame."""

from __future__ import annotations

from collections import OrderedDict
import logging
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.checks import checked_number
from track_before_detect.errors import DataError
from track_before_detect.recordings.read_errors import Closable, gathered_warnings
from track_before_detect.timestamps import in_seconds

_LOG = logging.getLogger(__name__)

# Frames kept for the overlap of successive batches; 20 frames of 1024 x 1024 float32 fit.
CACHE_BYTES = 128 * 2**20


class FrameSource(Protocol):
    """Where the frames of a recording come from; made for reading forwards."""

    def read(self, index: int) -> NDArray:
        """Return frame ``index``, shape (H, W)."""

    def close(self) -> None:
        """Close the file."""


class Recording:
    """Frames in time order, read when asked for.

    Recently read frames are kept, up to a fixed amount of memory, so that overlapping batches
    do not read the file twice. Usable as a context manager.

    Parameters
    ----------
    name : str
        File or folder name, for titles and messages.
    shape : tuple of int
        Height and width of every frame in pixels.
    dtype : dtype
        Type of the pixels, in native byte order.
    n_frames : int
        Number of frames, at least one.
    source : FrameSource
        Reads one frame.
    stamps : array, shape (T,), or None
        In seconds; kept as they are where they do not increase. None makes them up as 1 s apart,
        and says so.
    truth : array, shape (N, 4), or None
        Rows [frame, id, x, y].
    frame_id : str
        Coordinate frame of the sensor.
    unit_known : bool
        Whether the stamps are in seconds; otherwise their size tells their unit.

    Attributes
    ----------
    remarks : list of str
        What was made of stamps that are no seconds, or of none, and what else readers say of the
        recording, a sentence each.
    stamps_known : bool
        Whether the stamps are not made up.
    """

    def __init__(self, name: str, shape: tuple[int, int], dtype: np.dtype, n_frames: int,
                 source: FrameSource, stamps: ArrayLike | None = None,
                 truth: ArrayLike | None = None, frame_id: str = '',
                 unit_known: bool = True) -> None:
        if n_frames < 1:
            raise DataError(f'{name} holds no frames')
        if min(shape) < 1:
            raise DataError(f'frames of {name} have no pixels: {shape[0]} x {shape[1]}')
        dtype = np.dtype(dtype).newbyteorder('=')
        if dtype.kind not in 'iufc':
            raise DataError(f'frames of {name} must be numbers, got {dtype}')
        self.name = name
        self.shape = (int(shape[0]), int(shape[1]))
        self.dtype = dtype
        self.stamps_known = stamps is not None
        self.stamps, self._of_stamps = _checked_stamps(
            name, stamps, n_frames, unit_known)
        self.remarks = list(self._of_stamps)
        self.truth = None if truth is None else _checked_truth(name, truth)
        self.frame_id = frame_id
        self._source = source
        # Whether that was said; other frames of the file will be alike.
        self._is_odd = False
        self._cache: OrderedDict[int, NDArray] = OrderedDict()
        self._cache_length = max(2, CACHE_BYTES // (shape[0] * shape[1] * dtype.itemsize))

    def set_rate(self, fps: float) -> None:
        """Let the frames be 1/``fps`` seconds apart, whatever stamps came with them."""
        fps = checked_number('fps', fps, above=0)
        self.stamps = np.arange(len(self)) / fps
        others = [remark for remark in self.remarks if remark not in self._of_stamps]
        self._of_stamps = [f'{fps:g} frames/s as given, not the stamps of {self.name}'
                           ] if self.stamps_known else []
        self.remarks = [*self._of_stamps, *others]
        self.stamps_known = True

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, index: int) -> NDArray:
        """Return one frame, shape (H, W); the array must not be changed."""
        position = int(index)
        if position < 0:
            position += len(self)
        if not 0 <= position < len(self):
            raise IndexError(f'{self.name} has frames 0 to {len(self) - 1}, asked for {index}')
        if position in self._cache:
            return self._cache[position]
        with gathered_warnings() as odd:
            frame = np.asarray(self._source.read(position))
        if odd and not self._is_odd:
            self._is_odd = True
            _LOG.warning('frame %d of %s is damaged or unusual: %s', position, self.name, odd[0])
        check_like(f'frame {position} of {self.name}', frame, self.shape, self.dtype)
        frame = frame.astype(self.dtype, copy=False)
        frame.flags.writeable = False
        self._cache[position] = frame
        if len(self._cache) > self._cache_length:
            self._cache.popitem(last=False)
        return frame

    def close(self) -> None:
        """Close the file."""
        self._cache.clear()
        self._source.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class MappedSource:
    """Copies frames out of an array (T, H, W) in a mapped file; closes what mapped it."""

    def __init__(self, volume: NDArray, file: Closable | None = None) -> None:
        self._volume = volume
        self._file = file

    def read(self, index: int) -> NDArray:
        """Return frame ``index``, shape (H, W)."""
        return np.array(self._volume[index], self._volume.dtype.newbyteorder('='), order='C')

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def check_like(name: str, frame: NDArray, shape: tuple[int, ...], dtype: np.dtype) -> None:
    """Refuse a frame that is not of the size and type of the first."""
    if frame.shape != shape or frame.dtype.newbyteorder('=') != dtype:
        raise DataError(
            f'{name} must be like the first, {" x ".join(map(str, shape))} of {dtype}, got '
            f'{" x ".join(map(str, frame.shape))} of {frame.dtype}')


def _checked_stamps(name: str, stamps: ArrayLike | None, n_frames: int,
                    unit_known: bool) -> tuple[NDArray[np.float64], list[str]]:
    """Return stamps in seconds, made up when there are none, and what was made of them."""
    if stamps is None:
        return np.arange(n_frames, dtype=np.float64), [
            f'{name} has no stamps: 1 frame is taken as 1 s, so that speeds are in px/frame; '
            '--fps RATE gives its frames per second']
    stamps = np.asarray(stamps)
    if stamps.dtype.kind not in 'iuf':
        raise DataError(f'stamps of {name} must be real numbers (seconds), got {stamps.dtype}')
    if stamps.shape != (n_frames,):
        raise DataError(
            f'{name} must have one stamp per frame ({n_frames}), got an array of shape '
            f'{stamps.shape}')
    seconds, unit = (stamps.astype(np.float64), 'seconds') if unit_known else in_seconds(stamps)
    if not np.isfinite(seconds).any():
        raise DataError(f'stamps of {name} must be finite, got {seconds[0]} at frame 0')
    return seconds, [] if unit == 'seconds' else [f'stamps of {name} are read as {unit}']


def _checked_truth(name: str, truth: ArrayLike) -> NDArray[np.float64]:
    """Return truth rows as float64."""
    truth = np.asarray(truth)
    if truth.dtype.kind not in 'iuf' or truth.ndim != 2 or truth.shape[1] != 4:
        raise DataError(
            f'truth of {name} must be rows [frame, id, x, y], got an array of shape '
            f'{truth.shape} of {truth.dtype}')
    truth = truth.astype(np.float64)
    if not np.isfinite(truth).all():
        raise DataError(f'truth of {name} must be finite')
    return truth
