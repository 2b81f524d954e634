"""Several sensors that look at one plane, searched together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect import geometry
from track_before_detect.array_option import array_option, ArrayOption
from track_before_detect.checks import checked_frames, checked_number, checked_stamps
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf, Psf
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.types import Trajectory

# A plane of more pixels than all frames of a moment together, this many times, comes from maps in
# which the sensors look at different places.
MOST_PLANE_PER_SENSORS = 50


@dataclass(frozen=True, eq=False)
class Sensor:
    """Frames of one sensor and how it sees the common plane.

    Attributes
    ----------
    frames : array, shape (T, H, W)
        Real or complex pixel values, not finite where masked.
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
    variance : array, shape (H, W) or (T, H, W), optional
        Variance of the noise of each pixel in units of ``noise_sigma`` squared.
    mask : array, shape (H, W) or (T, H, W), optional
        Pixels that hold no data: those where it is not 0.
    """

    frames: ArrayLike
    stamps: ArrayLike
    affine: ArrayLike | None = None
    psf_sigma_px: float | None = None
    psf: ArrayLike | None = None
    noise_sigma: float = 1.0
    variance: ArrayLike | None = None
    mask: ArrayLike | None = None


class SensorPlane:
    """What several sensors see together, apart from their frames.

    Parameters
    ----------
    sensors : sequence of Sensor
        At least one; their frames are not looked at.
    shapes : sequence of (int, int)
        (H, W) of each sensor's frames.
    options : DetectorOptions
        Their PSF is that of sensors without one of their own.

    Attributes
    ----------
    measurement : MultiSensor
        How each sensor sees the plane, whose (0, 0) is ``origin``.
    noise_sigmas : tuple of float
        Standard deviation of the noise of each sensor.
    variances, masks : tuple of ArrayOption or None
        What is known of the pixels of each sensor.
    origin : array, shape (2,)
        x and y on the common plane of the first position that is searched.
    """

    def __init__(self, sensors: Sequence[Sensor], shapes: Sequence[tuple[int, int]],
                 options: DetectorOptions):
        psfs = tuple(_psf(n, sensor, options) for n, sensor in enumerate(sensors))
        self.variances, self.masks = (tuple(
            _array(n, name, getattr(sensor, name)) for n, sensor in enumerate(sensors))
            for name in ('variance', 'mask'))
        self.noise_sigmas = tuple(
            checked_number(f'noise_sigma of sensor {n}', sensor.noise_sigma, above=0.0)
            for n, sensor in enumerate(sensors))
        to_plane = np.array([_to_plane(n, sensor) for n, sensor in enumerate(sensors)])
        self.origin, shape = _plane(to_plane, shapes)
        maps = geometry.inverse(to_plane) @ geometry.translations(self.origin[None])
        self.measurement = MultiSensor(psfs, tuple(shapes), np.arange(len(sensors)), maps, shape)

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(H, W) of each sensor's frames."""
        return self.measurement.shapes


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
    taken : array of int, shape (T, 2)
        Number of the sensor that took each frame, and of the frame among its own.
    plane : SensorPlane
        What the sensors see together.
    """

    def __init__(self, sensors: Sequence[Sensor], options: DetectorOptions):
        _check_kind(sensors)
        if not len(sensors):
            raise DataError('sensors must hold at least one sensor, got none')
        self._frames = [checked_frames(sensor.frames, f'frames of sensor {n}')
                        for n, sensor in enumerate(sensors)]
        stamps = [checked_stamps(sensor.stamps, len(frames), f'stamps of sensor {n}')
                  for n, (sensor, frames) in enumerate(zip(sensors, self._frames, strict=True))]
        if len({np.iscomplexobj(frames) for frames in self._frames}) > 1:
            raise DataError('sensors must all hold real frames or all complex ones, got both')
        self.plane = SensorPlane(sensors, [frames.shape[1:] for frames in self._frames], options)
        order = np.argsort(np.concatenate(stamps), kind='stable')
        self.stamps = np.concatenate(stamps)[order]
        self.taken = np.array([
            (n, row) for n, own in enumerate(stamps) for row in range(len(own))])[order]

    @property
    def measurement(self) -> MultiSensor:
        """How each frame sees the plane."""
        return self.plane.measurement.slice(self.taken[:, 0])

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, index: int) -> NDArray:
        sensor, row = self.taken[index]
        return padded(self._frames[sensor][row], self.plane.shapes)


def _plane(to_plane: NDArray, shapes: Sequence[tuple[int, int]],
           ) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Return the first corner x, y and the size (H, W) of what the sensors see together."""
    corners = []
    for matrix, (height, width) in zip(to_plane, shapes, strict=True):
        own = np.array([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)])
        corners.append(geometry.apply(matrix, own))
    first = np.floor(np.min(corners, axis=(0, 1)) + 1e-6)
    across, down = np.ceil(np.max(corners, axis=(0, 1)) - 1e-6) - first + 1
    seen = sum(abs(np.linalg.det(matrix[:2, :2])) * shape[0] * shape[1]
               for matrix, shape in zip(to_plane, shapes, strict=True))
    if across * down > MOST_PLANE_PER_SENSORS * seen:
        raise DataError(
            f'the sensors see {seen:.3g} pixels of a plane of {across:.9g} x {down:.9g}: '
            'their affine maps must lead to places near each other')
    return first, (int(down), int(across))


def padded(frame: NDArray, shapes: Sequence[tuple[int, int]]) -> NDArray:
    """Return a frame of any of the sensors, padded with NaN to the size of the largest."""
    whole = np.full(np.max(shapes, axis=0), np.nan,
                    np.complex64 if np.iscomplexobj(frame) else np.float32)
    whole[:frame.shape[0], :frame.shape[1]] = frame
    return whole


def seen_by(number: int, sensor: Sensor,
            trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Return trajectories of the plane with their positions in the pixels of a sensor."""
    back = geometry.inverse(_to_plane(number, sensor))
    return [replace(one, positions=geometry.apply(back, one.positions)) for one in trajectories]


def _check_kind(sensors: Any) -> None:
    """Refuse what is no sequence of sensors."""
    if not isinstance(sensors, Sequence):
        raise DataError(
            f'sensors must be a list of Sensor, got {type(sensors).__name__}')
    for number, sensor in enumerate(sensors):
        if not isinstance(sensor, Sensor):
            raise DataError(
                f'sensors must be a list of Sensor, got {type(sensor).__name__} at {number}')


def _psf(number: int, sensor: Sensor, options: DetectorOptions) -> Psf:
    sigma = sensor.psf_sigma_px
    if sensor.psf is None and sigma is None:
        return psf_of(options)
    if sensor.psf is not None and sigma is not None:
        raise ParameterError(f'sensor {number} must have psf or psf_sigma_px, got both')
    try:
        if sensor.psf is not None:
            return ArrayPsf(sensor.psf)
        return GaussianPsf(checked_number('psf_sigma_px', sigma))
    except ParameterError as error:
        raise ParameterError(f'sensor {number}: {error}') from error


def _to_plane(number: int, sensor: Sensor) -> NDArray[np.float64]:
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


def _array(number: int, name: str, value: ArrayLike | None) -> ArrayOption | None:
    try:
        return None if value is None else array_option(name, value)
    except ParameterError as error:
        raise ParameterError(f'sensor {number}: {error}') from error
