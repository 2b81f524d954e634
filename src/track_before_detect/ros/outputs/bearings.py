"""Points of a cloud with the rays on which a calibrated camera sees them. No ROS types in here."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.ros.intake.camera import Camera

NAMES = ('ray_x', 'ray_y', 'ray_z', 'azimuth', 'elevation', 'var_azimuth',
         'cov_azimuth_elevation', 'var_elevation')


def with_bearings(points: NDArray, camera: Camera | None) -> NDArray:
    """Return structured points (N,) with fields for their rays; as they are without a camera.

    The fields are ray_x, ray_y and ray_z, a unit vector of the camera's frame, azimuth and
    elevation in radians, to the right and up, var_azimuth, cov_azimuth_elevation and
    var_elevation.

    Parameters
    ----------
    points : structured array, shape (N,)
        Of x, y, var_x, cov_xy and var_y in pixels.
    camera : Camera or None
    """
    if camera is None:
        return points
    before: Mapping[str, Any] = points.dtype.fields or {}
    size, formats = points.dtype.itemsize, [kind for kind, *_ in before.values()]
    more: NDArray[Any] = np.zeros(len(points), np.dtype({
        'names': [*before, *NAMES], 'formats': [*formats, *['<f4'] * len(NAMES)],
        'offsets': [*(offset for _, offset, *_ in before.values()),
                    *range(size, size + 4 * len(NAMES), 4)],
        'itemsize': size + 4 * len(NAMES)}))
    for name in before:
        more[name] = points[name]
    positions = np.column_stack([points['x'], points['y']])
    covariance = np.stack([points[name] for name in ('var_x', 'cov_xy', 'cov_xy', 'var_y')],
                          axis=1).reshape(-1, 2, 2)
    angular = camera.covariance(positions, covariance).reshape(-1, 4)
    for name, values in zip(NAMES, np.column_stack(
            [camera.rays(positions), camera.angles(positions), angular[:, [0, 1, 3]]]).T,
            strict=True):
        more[name] = values
    return more
