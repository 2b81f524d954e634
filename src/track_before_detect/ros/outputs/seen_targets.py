"""The targets of one frame, and where a radar saw them. No ROS types in here."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.types import Trajectory


class SeenTarget(NamedTuple):
    """One target in one frame.

    Attributes
    ----------
    id : int
        Of the trajectory.
    position : array, shape (2,)
        x and y in pixels.
    velocity : array, shape (2,)
        Pixels per second.
    covariance : array, shape (2, 2)
        Of the position, px^2; NaN where it is not known.
    snr : float
        Of the trajectory.
    """

    id: int
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]
    snr: float


def targets_in(trajectories: Iterable[Trajectory], frame_index: int) -> list[SeenTarget]:
    """Return the targets that are present in the frame of this number."""
    return [
        SeenTarget(one.id, one.positions[row], one.velocity[row], one.covariance[row], one.snr)
        for one in trajectories for row in np.flatnonzero(one.frame_indices == frame_index)
        if np.isfinite(one.positions[row]).all()]


class RadarMotion(NamedTuple):
    """Position and velocity of a target in the frame of the radar: x ahead, y to the left.

    Attributes
    ----------
    position, velocity : array, shape (3,)
        Metres, metres per second.
    position_covariance, velocity_covariance : array, shape (3, 3)
        NaN where not known.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    position_covariance: NDArray[np.float64]
    velocity_covariance: NDArray[np.float64]


@dataclass(frozen=True)
class RadarScale:
    """What rows and columns of radar maps are: rows range, columns bearing or Doppler.

    Attributes
    ----------
    range_m : float
        From one row to the next.
    first_range_m : float
        Of row 0.
    bearing_rad : float
        From one column to the next, anticlockwise (REP 103); 0 where columns are Doppler.
    first_bearing_rad : float
        Of column 0; 0 is straight ahead.
    doppler_m_s : float
        From one column to the next, positive where receding; 0 where columns are bearing.
    """

    range_m: float
    first_range_m: float = 0.0
    bearing_rad: float = 0.0
    first_bearing_rad: float = 0.0
    doppler_m_s: float = 0.0

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> 'RadarScale | None':
        """Return the scale that the parameters of a node give, None where they give none.

        Raises
        ------
        ParameterError
            The scale of the columns is missing, there are two, or one has no rows beside it.
        """
        scale = cls(values['range_m_per_row'], values['range_of_first_row_m'],
                    values['bearing_rad_per_column'], values['bearing_of_first_column_rad'],
                    values['doppler_m_s_per_column'])
        n_columns = (scale.bearing_rad != 0) + (scale.doppler_m_s != 0)
        if not scale.range_m and not n_columns:
            return None
        if not scale.range_m or n_columns != 1:
            raise ParameterError(
                'tracks of a radar need range_m_per_row and one of bearing_rad_per_column and '
                f'doppler_m_s_per_column, got {scale.range_m:g}, {scale.bearing_rad:g} and '
                f'{scale.doppler_m_s:g}')
        return scale

    def motion(self, target: SeenTarget, still_column: float,
               period_columns: int = 0) -> RadarMotion:
        """Return where a target is, and how it moves.

        Without a bearing it is taken to be straight ahead, its range the uncertainty of where it
        is across.

        Parameters
        ----------
        target : SeenTarget
        still_column : float
            The column of Doppler zero.
        period_columns : int
            After which Doppler begins again, where the change of range says which it is; else 0.
        """
        column, row = target.position
        distance = self.first_range_m + self.range_m * row
        steps = np.array([self.bearing_rad or 1.0, self.range_m])
        variance = target.covariance * steps * steps[:, None]
        position, velocity = np.zeros((2, 3))
        position_covariance, velocity_covariance = np.zeros((3, 3)), np.full((3, 3), np.nan)
        if self.doppler_m_s:
            position[0] = distance
            velocity[0] = self.doppler_m_s * (column - still_column)
            if period_columns:
                period = self.doppler_m_s * period_columns
                wrapped = self.range_m * target.velocity[1] - velocity[0]
                velocity[0] += period * round(wrapped / period)
            position_covariance[[0, 1], [0, 1]] = variance[1, 1], distance**2
            velocity_covariance[0, 0] = self.doppler_m_s**2 * target.covariance[0, 0]
        else:
            bearing = self.first_bearing_rad + self.bearing_rad * column
            ahead, left = math.cos(bearing), math.sin(bearing)
            # Of x and y by bearing and range.
            slope = np.array([[-distance * left, ahead], [distance * ahead, left]])
            position[:2] = distance * ahead, distance * left
            velocity[:2] = slope @ (target.velocity * steps)
            position_covariance[:2, :2] = slope @ variance @ slope.T
        return RadarMotion(position, velocity, position_covariance, velocity_covariance)
