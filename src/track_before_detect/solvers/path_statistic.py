"""What the value of a path means: the statistic that is compared with the threshold."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.presence import frames_seen_in, Presence


@dataclass(frozen=True)
class PathStatistic:
    """Between values, which add up along a path, statistics and penalties.

    A statistic is that of a path of equal value which is present in every frame, so that a
    threshold means the same whether targets may enter and leave or not.

    Attributes
    ----------
    amplitudes : AmplitudeModel
        Says what a value is worth.
    presence : Presence or None
        Cost of being present; None where targets are there all the time.
    """

    amplitudes: AmplitudeModel
    presence: Presence | None

    def statistic(self, value: float, n_frames: int) -> float:
        """Return the statistic of a path of this value."""
        return self.amplitudes.from_value(value + self._whole_cost(n_frames))

    def penalty(self, threshold: float, n_frames: int) -> float:
        """Return lambda of a path without any cost."""
        whole = self._whole_cost(n_frames)
        if whole == 0.0:
            return threshold
        if threshold**2 <= whole:
            raise ParameterError(
                f'threshold must be above {whole**0.5:.3g} for batches of {n_frames} frames with '
                f'presence partial, got {threshold:g}')
        return (threshold**2 - whole)**0.5

    def present(self, positions: NDArray, seen: NDArray) -> NDArray[np.bool_]:
        """Return in which frames (T,) the target of a path is reported.

        Parameters
        ----------
        positions : array, shape (T, 2)
            NaN where the path is absent.
        seen : array, shape (T,)
            Statistic of each frame along it.
        """
        present = np.isfinite(positions[:, 0])
        if self.presence is not None:
            [frames] = np.nonzero(present)
            first, last = frames_seen_in(self.amplitudes.rectified(seen[frames]))
            present[:frames[first]] = False
            present[frames[last] + 1:] = False
        return present

    def _whole_cost(self, n_frames: int) -> float:
        return self.presence.whole_cost(n_frames) if self.presence else 0.0
