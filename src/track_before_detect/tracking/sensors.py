"""Several sensors that look at one plane, searched together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect import geometry
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf, Psf
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.prepare import prepare, PreparedBatch
from track_before_detect.solvers.batch_detector import FoundTrajectory
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.greedy import GreedyDetector
from track_before_detect.solvers.path_detector import PathDetector
from track_before_detect.tracking.previous_batch import map_previous_batch
from track_before_detect.tracking.stitcher import Stitcher
from track_before_detect.tracking.timestamps import check_increasing
from track_before_detect.types import DetectionResult, FrameBatch, Progress, Trajectory

DETECTORS: dict[str, type[PathDetector]] = {'convex': ConvexDetector, 'greedy': GreedyDetector}
# A plane of more pixels than all frames of a moment together, this many times, comes from maps in
# which the sensors look at different places.
MOST_PLANE_PER_SENSORS = 50


@dataclass(frozen=True, eq=False)
class Sensor:
    """Frames of one sensor and how it sees the common plane.

    Attributes
    ----------
    frames : array, shape (T, H, W)
        Real pixel values, not finite where masked.
    stamps : array, shape (T,)
        Seconds, strictly increasing, on the clock of all sensors.
    affine : array, shape (2, 3), optional
        Takes (x, y, 1) in pixels of this sensor to pixels of the common plane; the plane is that
        of this sensor unless given.
    psf_sigma_px : float, optional
        Of its Gaussian point spread function in its own pixels; what the options say of the
        point spread function unless given.
    psf : array, shape (H, W), optional
        Point spread function in its own pixels, both sides odd; instead of ``psf_sigma_px``.
    noise_sigma : float
        Standard deviation of the noise of a pixel.
    """

    frames: ArrayLike
    stamps: ArrayLike
    affine: ArrayLike | None = None
    psf_sigma_px: float | None = None
    psf: ArrayLike | None = None
    noise_sigma: float = 1.0


class SensorArray:
    """The frames of all sensors in the order of their stamps, offered as one recording.

    Frames of equal stamps come in the order of the sensors. All are padded with NaN to the size
    of the largest.

    Parameters
    ----------
    sensors : sequence of Sensor
        At least one.
    options : DetectorOptions
        Their PSF is that of sensors without one of their own.

    Attributes
    ----------
    stamps : array, shape (T,)
        Seconds, of all frames.
    sensor : array of int, shape (T,)
        Number of the sensor that took each frame.
    psfs : tuple of Psf
        Of each sensor.
    noise_sigmas : tuple of float
        Standard deviation of the noise of each.
    shapes : tuple of (int, int)
        (H, W) of each sensor's frames.
    origin : array, shape (2,)
        x and y on the common plane of the first position that is searched.
    plane_shape : tuple of int
        (H, W) of the part of the plane that is searched: the box around all that is seen.
    """

    def __init__(self, sensors: Sequence[Sensor], options: DetectorOptions):
        _check_kind(sensors)
        if not len(sensors):
            raise DataError('sensors must hold at least one sensor, got none')
        self._frames = [_checked_frames(n, sensor) for n, sensor in enumerate(sensors)]
        stamps = [_checked_stamps(n, sensor, len(frames))
                  for n, (sensor, frames) in enumerate(zip(sensors, self._frames, strict=True))]
        self.psfs = tuple(_psf(n, sensor, options) for n, sensor in enumerate(sensors))
        self.noise_sigmas = tuple(float(sensor.noise_sigma) for sensor in sensors)
        self.shapes = tuple(frames.shape[1:] for frames in self._frames)
        self._from_plane = geometry.inverse(
            np.array([_to_plane(n, sensor) for n, sensor in enumerate(sensors)]))
        order = np.argsort(np.concatenate(stamps), kind='stable')
        self.stamps = np.concatenate(stamps)[order]
        self.sensor = np.repeat(np.arange(len(sensors)), [len(own) for own in stamps])[order]
        self._row = np.concatenate([np.arange(len(own)) for own in stamps])[order]
        self.origin, self.plane_shape = self._plane()

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, index: int) -> NDArray:
        frame = self._frames[self.sensor[index]][self._row[index]]
        padded = np.full(np.max(self.shapes, axis=0), np.nan, np.float32)
        padded[:frame.shape[0], :frame.shape[1]] = frame
        return padded

    def view(self, indices: NDArray) -> MultiSensor:
        """Return how some of the frames see the plane, whose (0, 0) is ``origin``."""
        sensor = self.sensor[indices]
        maps = self._from_plane @ geometry.translations(self.origin[None])
        return MultiSensor(self.psfs, self.shapes, sensor, maps[sensor], self.plane_shape)

    def _plane(self):
        """Return the first corner x, y and the size (H, W) of what the sensors see together."""
        corners = []
        for matrix, (height, width) in zip(geometry.inverse(self._from_plane), self.shapes,
                                           strict=True):
            own = np.array([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)])
            corners.append(geometry.apply(matrix, own))
        first = np.floor(np.min(corners, axis=(0, 1)) + 1e-6)
        width, height = np.ceil(np.max(corners, axis=(0, 1)) - 1e-6) - first + 1
        seen = sum(abs(np.linalg.det(matrix[:2, :2])) * shape[0] * shape[1] for matrix, shape in
                   zip(geometry.inverse(self._from_plane), self.shapes, strict=True))
        if width * height > MOST_PLANE_PER_SENSORS * seen:
            raise DataError(
                f'the sensors see {seen:.3g} pixels of a plane of {width:.9g} x {height:.9g}: '
                'their affine maps must lead to places near each other')
        return first, (int(height), int(width))


class SensorPipeline:
    """Preprocessing of each sensor, detection on the plane and identities over batches.

    Parameters
    ----------
    array : SensorArray
        The frames that batches are made of.
    options : DetectorOptions
        What to look for and how.
    """

    def __init__(self, array: SensorArray, options: DetectorOptions):
        _check(options)
        self._array = array
        self._options = options
        self._stitcher: Stitcher | None = None
        self._before: list[Trajectory] = []

    def process(self, batch: FrameBatch, progress: Progress | None = None) -> DetectionResult:
        """Find the trajectories of a batch; positions are those of the common plane."""
        view = self._array.view(batch.frame_indices)
        frames = np.full(batch.frames.shape, np.nan, np.float32)
        units = np.full(batch.frames.shape, np.nan, np.float32)
        weights = np.zeros(batch.frames.shape, np.float32)
        for sensor in np.unique(view.sensor):
            rows = np.flatnonzero(view.sensor == sensor)
            if not np.isfinite(batch.frames[rows]).any():
                # It looks away; the others go on.
                continue
            prepared = self._prepared(batch, rows, int(sensor))
            height, width = view.shapes[sensor]
            frames[rows, :height, :width] = prepared.frames
            plain = prepared.weights is None
            weights[rows, :height, :width] = 1.0 if plain else prepared.weights
            units[rows, :height, :width] = self._array.noise_sigmas[sensor] * (
                prepared.noise_level if plain else prepared.unit)
        if not weights.any():
            raise DataError(f'no pixel of the {len(batch)} frames is finite')
        detector = DETECTORS[self._options.detector](self._options, view)
        on_plane = np.tile(geometry.translations(self._array.origin[None]), (len(batch), 1, 1))
        detector.earlier = map_previous_batch(self._before, batch.frame_indices, on_plane)
        result = detector.detect_weighted(
            frames, batch.stamps, None if np.all(weights == 1) else weights, progress)
        if self._stitcher is None:
            self._stitcher = Stitcher(view.width_px)
        trajectories = [self._on_plane(found, view, units, batch) for found in result.found]
        self._before = self._stitcher.link(trajectories)
        return DetectionResult(list(self._before), result.threshold, result.status,
                               result.history, result.gap)

    def _prepared(self, batch, rows, sensor) -> PreparedBatch:
        height, width = self._array.shapes[sensor]
        own = FrameBatch(
            batch.frames[rows, :height, :width] / np.float32(self._array.noise_sigmas[sensor]),
            batch.stamps[rows], batch.frame_indices[rows])
        return prepare(own, self._options, self._array.psfs[sensor].width_px)

    def _on_plane(self, found: FoundTrajectory, view, units, batch) -> Trajectory:
        """Return a trajectory on the plane, amplitudes in the units of each frame's sensor."""
        at = np.rint(geometry.apply(view.maps, found.positions))
        amplitudes = np.full(len(at), np.nan)
        for t, (x, y) in enumerate(at):
            height, width = view.shapes[view.sensor[t]]
            if 0 <= x < width and 0 <= y < height:
                amplitudes[t] = found.amplitudes[t] * units[t, int(y), int(x)]
        positions = found.positions + self._array.origin
        moments, first, back = np.unique(batch.stamps, return_index=True, return_inverse=True)
        velocity = np.zeros_like(positions)
        if len(moments) > 1:
            velocity = np.gradient(positions[first], moments, axis=0)[back]
        return Trajectory(0, positions, amplitudes, velocity, batch.stamps, batch.frame_indices,
                          found.statistic, found.snr)


def _check(options):
    """Refuse options that several sensors cannot honour."""
    if options.detector not in DETECTORS:
        raise ParameterError(
            f'detector must be one of {", ".join(DETECTORS)} for several sensors, got '
            f'{options.detector!r}')
    if options.registration != 'none':
        raise ParameterError(
            'registration must be none for several sensors, whose maps are given, got '
            f'{options.registration!r}')
    if options.motion_model in ('range_doppler', 'range_bearing'):
        raise ParameterError(
            'motion_model must be that of a plane for several sensors, got '
            f'{options.motion_model}')
    if options.amplitudes == 'complex':
        raise ParameterError(
            'amplitudes must be non-negative or signed for several sensors, got complex')
    if options.presence != 'full':
        raise ParameterError(
            f'presence must be full for several sensors, got {options.presence!r}')
    for name in ('variance', 'mask'):
        if getattr(options, name) is not None:
            raise ParameterError(
                f'{name} must be left out for several sensors: give each its noise_sigma, and '
                'NaN to its masked pixels')
    if options.amplitude_model == 'constant':
        raise ParameterError(
            'amplitude_model must be fluctuating for several sensors, got constant: what is '
            'constant in the units of one sensor is not in those of another')


def _check_kind(sensors):
    """Refuse what is no sequence of sensors."""
    if not isinstance(sensors, Sequence):
        raise DataError(
            f'sensors must be a list of Sensor, got {type(sensors).__name__}')
    for number, sensor in enumerate(sensors):
        if not isinstance(sensor, Sensor):
            raise DataError(
                f'sensors must be a list of Sensor, got {type(sensor).__name__} at {number}')


def _is_number(value):
    # To Python a truth value is a whole number.
    return (isinstance(value, (int, float, np.integer, np.floating))
            and not isinstance(value, bool))


def _checked_frames(number, sensor):
    try:
        frames = np.asarray(sensor.frames)
    except (TypeError, ValueError) as error:
        raise DataError(f'frames of sensor {number} must be an array: {error}') from error
    if frames.ndim != 3 or 0 in frames.shape:
        raise DataError(f'frames of sensor {number} must have shape (T, H, W) with no empty side, '
                        f'got {frames.shape}')
    if frames.dtype.kind not in 'iuf':
        raise DataError(
            f'frames of sensor {number} must hold real numbers, got {frames.dtype}')
    if not (_is_number(sensor.noise_sigma) and 0 < sensor.noise_sigma < math.inf):
        raise ParameterError(f'noise_sigma of sensor {number} must be a number above 0, got '
                             f'{sensor.noise_sigma!r}')
    return frames


def _checked_stamps(number, sensor, n_frames):
    try:
        stamps = np.asarray(sensor.stamps)
    except (TypeError, ValueError) as error:
        raise DataError(f'stamps of sensor {number} must be numbers: {error}') from error
    if stamps.dtype.kind not in 'iuf':
        raise DataError(
            f'stamps of sensor {number} must be real numbers (seconds), got {stamps.dtype}')
    stamps = stamps.astype(float)
    if stamps.shape != (n_frames,):
        raise DataError(f'stamps of sensor {number} must have shape ({n_frames},), got '
                        f'{stamps.shape}')
    check_increasing(stamps, f'stamps of sensor {number}')
    return stamps


def _psf(number, sensor, options) -> Psf:
    sigma = sensor.psf_sigma_px
    if sensor.psf is None and sigma is None:
        return psf_of(options)
    if sensor.psf is not None and sigma is not None:
        raise ParameterError(f'sensor {number} must have psf or psf_sigma_px, got both')
    if sigma is not None and not _is_number(sigma):
        raise ParameterError(f'psf_sigma_px of sensor {number} must be a number, got {sigma!r}')
    try:
        return ArrayPsf(sensor.psf) if sigma is None else GaussianPsf(sigma)
    except ParameterError as error:
        raise ParameterError(f'sensor {number}: {error}') from error


def _to_plane(number, sensor):
    """Return the map from the pixels of a sensor to the plane, shape (3, 3)."""
    matrix = np.eye(3)
    if sensor.affine is not None:
        try:
            affine = np.asarray(sensor.affine)
        except (TypeError, ValueError) as error:
            raise ParameterError(
                f'affine of sensor {number} must be an array: {error}') from error
        if affine.shape != (2, 3) or affine.dtype.kind not in 'iuf':
            raise ParameterError(
                f'affine of sensor {number} must be real numbers of shape (2, 3), got '
                f'{affine.dtype} of shape {affine.shape}')
        matrix[:2] = affine
    if not (np.all(np.isfinite(matrix)) and abs(np.linalg.det(matrix)) > 1e-9):
        raise ParameterError(
            f'affine of sensor {number} must be finite and invertible, got {matrix[:2].tolist()}')
    return matrix
