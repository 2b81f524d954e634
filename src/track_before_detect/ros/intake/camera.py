"""Where the pixels of a calibrated camera look: rays, angles and their covariance.

No ROS types in here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError

# Steps of Newton's method, far more than lenses take, and what may be left of a position on the
# plane at distance one: where a model of distortion turns back nothing is seen.
STEPS, LEFT_OVER = 30, 1e-9
# Pixels over which a slope is taken.
SLOPE_PX = 0.5


def _brown(points: NDArray, coefficients: NDArray) -> NDArray:
    """Return where a lens moves points (N, 2) of the plane at distance one."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = points.T
    square = x**2 + y**2
    radial = ((1 + square * (k1 + square * (k2 + square * k3)))
              / (1 + square * (k4 + square * (k5 + square * k6))))
    return np.column_stack([
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
        y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y])


def _rays_of_brown(seen: NDArray, coefficients: NDArray) -> NDArray:
    """Return rays (N, 3) that a lens sends to places (N, 2), by Newton's method."""
    points, step = seen.copy(), 1e-6
    for _ in range(STEPS):
        slopes = np.stack([(_brown(points + side, coefficients)
                            - _brown(points - side, coefficients)) / (2 * step)
                           for side in step * np.eye(2)], axis=2)
        across = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
        right, down = (_brown(points, coefficients) - seen).T
        points = points - np.column_stack([
            slopes[:, 1, 1] * right - slopes[:, 0, 1] * down,
            slopes[:, 0, 0] * down - slopes[:, 1, 0] * right]) / across[:, None]
    # Beyond the turn of the model a place is seen mirrored.
    turned = (across <= 0) | (np.trace(slopes, axis1=1, axis2=2) <= 0)
    left = np.abs(_brown(points, coefficients) - seen).max(axis=1)
    points[turned | ~(left < LEFT_OVER)] = np.nan
    return np.column_stack([points, np.ones(len(points))])


def _rays_of_equidistant(seen: NDArray, coefficients: NDArray) -> NDArray:
    """Return rays (N, 3) that a fisheye sends to places (N, 2), also from behind the camera."""
    bent = np.hypot(*seen.T)
    polynomial = np.polynomial.Polynomial(np.concatenate([
        [0.0, 1.0], np.column_stack([np.zeros(4), coefficients]).ravel()]))
    angle = bent.copy()
    for _ in range(STEPS):
        angle = angle - (polynomial(angle) - bent) / polynomial.deriv()(angle)
    turned = (polynomial.deriv()(angle) <= 0) | (angle < 0) | (angle > np.pi)
    angle[turned | ~(np.abs(polynomial(angle) - bent) < LEFT_OVER)] = np.nan
    scale = np.sin(angle) / np.where(bent > 0, bent, 1.0)
    return np.column_stack([seen * scale[:, None], np.cos(angle)])


# Each with the numbers of coefficients that it may have.
MODELS: dict[str, tuple[Callable[[NDArray, NDArray], NDArray], tuple[int, ...]]] = {
    'plumb_bob': (_rays_of_brown, (0, 4, 5)),
    'rational_polynomial': (_rays_of_brown, (8,)),
    'equidistant': (_rays_of_equidistant, (4,)),
}


@dataclass(frozen=True, eq=False)
class Camera:
    """What a camera sees where: x of its frame to the right, y down, z ahead (REP 103).

    Attributes
    ----------
    shape : tuple of int
        (H, W) of its frames.
    frame_id : str
        Its optical frame.
    matrix : array, shape (3, 3)
        Takes rays to pixels of the whole sensor.
    rotation : array, shape (3, 3)
        Takes rays behind the lens to those of the frame.
    model : str
        Of :data:`MODELS`.
    coefficients : tuple of float
        Of the distortion.
    offset, binning : tuple of float
        x and y of the first pixel of a frame, and how many make one.
    """

    shape: tuple[int, int]
    frame_id: str
    matrix: NDArray[np.float64]
    rotation: NDArray[np.float64]
    model: str = 'plumb_bob'
    coefficients: Sequence[float] = ()
    offset: tuple[float, float] = (0.0, 0.0)
    binning: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise DataError(f'distortion_model must be one of {", ".join(MODELS)}, got '
                            f'{self.model!r}')
        allowed = MODELS[self.model][1]
        given = np.asarray(self.coefficients, float)
        if len(given) not in allowed or not np.all(np.isfinite(given)):
            raise DataError(f'the distortion of {self.model} must be {_or(allowed)} finite '
                            f'numbers, got {given.tolist()}')
        if not self.matrix[0, 0] or not self.matrix[1, 1]:
            raise DataError('the camera is not calibrated: a focal length is 0')
        try:
            np.linalg.inv(self.matrix)
        except np.linalg.LinAlgError as error:
            raise DataError('the matrix of the camera cannot be inverted, got '
                            f'{np.ravel(self.matrix).tolist()}') from error

    def rays(self, positions: NDArray) -> NDArray[np.float64]:
        """Return unit vectors (N, 3) towards what is seen at x and y (N, 2) of a frame.

        NaN where the model of the distortion has nothing.
        """
        positions = np.asarray(positions, float).reshape(-1, 2)
        pixels = np.column_stack([positions * self.binning + self.offset,
                                  np.ones(len(positions))])
        seen = (pixels @ np.linalg.inv(self.matrix).T)[:, :2]
        undistorted, counts = MODELS[self.model]
        # Missing ones are zero.
        coefficients = np.zeros(4 if counts == (4,) else 8)
        coefficients[:len(self.coefficients)] = self.coefficients
        with np.errstate(all='ignore'):
            rays = undistorted(seen, coefficients) @ self.rotation.T
            return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def angles(self, positions: NDArray) -> NDArray[np.float64]:
        """Return azimuth, to the right, and elevation, up, in radians, (N, 2)."""
        x, y, z = self.rays(positions).T
        return np.column_stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))])

    def covariance(self, positions: NDArray, covariance: NDArray) -> NDArray[np.float64]:
        """Return the covariance (N, 2, 2) of angles, in rad^2, from that of positions in px^2."""
        slopes = np.stack([
            (self.angles(positions + side) - self.angles(positions - side)) / (2 * SLOPE_PX)
            for side in SLOPE_PX * np.eye(2)], axis=2)
        return slopes @ covariance @ slopes.swapaxes(1, 2)


def _or(numbers: Sequence[int]) -> str:
    return ' or '.join(map(str, numbers))
