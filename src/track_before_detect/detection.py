"""The detection as one call."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.checks import check_axes, checked_frames, checked_stamps
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.presets import choose_for, NONE
from track_before_detect.tracking.recording import detect_recording
from track_before_detect.tracking.sensor_pipeline import SensorPipeline
from track_before_detect.tracking.sensors import Sensor, SensorArray
from track_before_detect.types import DetectionResult, Progress


class _ArrayRecording:
    """Frames of an array, offered as a recording."""

    def __init__(self, frames: NDArray, stamps: NDArray[np.float64]):
        self._frames = frames
        self.stamps = stamps

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> NDArray:
        return self._frames[index]


def detect(frames: ArrayLike, stamps: ArrayLike | None = None, detector: str = 'convex', *,
           preset: str = NONE, progress: Progress | None = None,
           **options: Any) -> DetectionResult:
    """Find the trajectories of moving targets in a sequence of frames.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Pixel values; not finite, or masked by ``numpy.ma``, where masked. A 1-D sensor has
        H = 1. Unless ``noise`` says otherwise, the noise has a standard deviation of 1.
    stamps : array, shape (T,), optional
        Seconds, strictly increasing; 1 s apart unless given.
    detector : str
        Method.
    preset : str
        Where the options come from that are not given: ``'none'`` takes the defaults, ``'auto'``
        looks at the first frames, others are for a kind of sensor, as in ``tbd detect``.
    progress : callable, optional
        Called with a label and the share done, 0 to 1, during long work.
    **options
        Fields of :class:`DetectorOptions`.

    Returns
    -------
    DetectionResult
        ``trajectories``, ``threshold``, ``status``, ``history``, ``gap``, and ``remarks``, of
        which the first say why ``preset='auto'`` took its options.

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
    array = checked_frames(frames)
    check_axes(array.shape, 'frames')
    times = checked_stamps(np.arange(len(array)) if stamps is None else stamps, len(array))
    recording = _ArrayRecording(array, times)
    settings, reasons = choose_for(recording, preset, {'detector': detector, **options})
    return detect_recording(recording, settings, progress, reasons=reasons)


def detect_sensors(sensors: Sequence[Sensor], detector: str = 'convex', *,
                   progress: Progress | None = None, **options: Any) -> DetectionResult:
    """Find the trajectories of targets that several sensors see at once or in turn.

    A target is searched on a common plane, at the place where each frame of each sensor shows it:
    none is resampled, so their noise stays what it is. What no sensor finds alone may be found by
    all of them together.

    Parameters
    ----------
    sensors : sequence of Sensor
        Frames, stamps, map to the plane, point spread function and noise of each. Stamps may
        interleave and coincide.
    detector : str
        ``'convex'`` or ``'greedy'``.
    progress
        As of :func:`detect`.
    **options
        Fields of :class:`DetectorOptions`; speeds are those on the plane, a frame is one of any
        sensor. ``registration``, constant amplitudes and range-Doppler maps are refused.

    Returns
    -------
    DetectionResult
        As of :func:`detect`, positions and velocities on the common plane. The rows of a
        trajectory are the frames of all sensors in the order of their stamps, equal stamps in the
        order of the sensors; amplitudes are in the units of the sensor that took the frame, NaN
        where the target is outside its view.

    Raises
    ------
    ParameterError, DataError
        As of :func:`detect`, also for an attribute of a sensor.

    Examples
    --------
    >>> import numpy as np
    >>> import track_before_detect as tbd
    >>> frames = np.zeros((4, 32, 32))
    >>> frames[:, 16, 16] = 20.0
    >>> turned = tbd.Sensor(frames.transpose(0, 2, 1)[:, ::-1], np.arange(4) + 0.5,
    ...                     affine=[[0, -1, 31], [1, 0, 0]])
    >>> result = tbd.detect_sensors([tbd.Sensor(frames, np.arange(4)), turned], threshold=8)
    >>> [t.positions[0].round().tolist() for t in result.trajectories]
    [[16.0, 16.0]]
    """
    settings = DetectorOptions.from_mapping({'detector': detector, **options})
    array = SensorArray(sensors, settings)
    return detect_recording(array, settings, progress, SensorPipeline(array.plane, settings))
