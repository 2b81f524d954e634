"""The detection as one call."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from track_before_detect.errors import DataError
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.recorded import detect_recording
from track_before_detect.types import DetectionResult, Progress


class _ArrayRecording:
    """Frames of an array, offered as a recording."""

    def __init__(self, frames, stamps):
        self._frames = frames
        self.stamps = stamps

    def __len__(self):
        return len(self._frames)

    def __getitem__(self, index):
        return self._frames[index]


def detect(frames: ArrayLike, stamps: ArrayLike | None = None, detector: str = 'convex', *,
           progress: Progress | None = None,
           **options: Any) -> DetectionResult:
    """Find the trajectories of moving targets in a sequence of frames.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Pixel values; not finite where masked. A 1-D sensor has H = 1. Unless ``noise`` says
        otherwise, the noise has a standard deviation of 1.
    stamps : array, shape (T,), optional
        Seconds, strictly increasing; 1 s apart unless given.
    detector : str
        Method.
    progress : callable, optional
        Called with a label and the share done, 0 to 1, during long work.
    **options
        Fields of :class:`DetectorOptions`.

    Returns
    -------
    DetectionResult
        ``trajectories``, ``threshold``, ``status``, ``history``, ``gap``.

    Raises
    ------
    ParameterError
        An option is unknown or out of range.
    DataError
        Frames or stamps cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import track_before_detect as tbd
    >>> frames = np.zeros((5, 32, 32))
    >>> frames[:, 16, 16] = 20.0
    >>> [t.positions[0].round().tolist() for t in tbd.detect(frames, threshold=8).trajectories]
    [[16.0, 16.0]]
    """
    settings = DetectorOptions.from_mapping({'detector': detector, **options})
    array = _as_array('frames', frames)
    if array.ndim != 3 or 0 in array.shape:
        raise DataError(
            f'frames must have shape (T, H, W) with no empty side, got {array.shape}')
    if array.dtype == bool or not np.issubdtype(array.dtype, np.number):
        raise DataError(f'frames must hold numbers, got {array.dtype}')
    times = np.arange(float(len(array))) if stamps is None else _as_array('stamps', stamps, float)
    if times.shape != (len(array),):
        raise DataError(f'stamps must have shape ({len(array)},), got {times.shape}')
    return detect_recording(_ArrayRecording(array, times), settings, progress)


def _as_array(name, values, dtype=None):
    try:
        return np.asarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise DataError(f'{name} must be an array of numbers: {error}') from error
