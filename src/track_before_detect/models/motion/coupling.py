"""Range-Doppler maps: the Doppler column of a target says how fast its range changes.

A state is (range row y, Doppler column x); it moves by dy/dt = k (x - x_0), where x_0 is the
column of targets at rest. Seen from the middle of the batch, every column is a plane that slides
at its own speed: with y' = y - k (x - x_0) tau, tau the time from the middle, a target of constant
Doppler stands still, and one whose Doppler changes at the rate a moves by dy'/dt = -k a tau, the
same in all columns. So the maps are sheared once, and the search of the plane serves.
"""

from __future__ import annotations

import builtins
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RangeDopplerCoupling:
    """How the column of a target moves its row.

    Attributes
    ----------
    rows_per_column : float
        k: rows per unit of time for each column beside ``still_column``.
    still_column : float
        x_0 in pixels.
    times : array, shape (T,)
        tau of each frame.
    """

    rows_per_column: float
    still_column: float
    times: NDArray[np.float64]

    def shifts(self, n_columns: int, step_px: float) -> NDArray[np.int32]:
        """Return y - y' in grid steps for each frame and grid column, shape (T, X)."""
        columns = np.arange(n_columns) * step_px - self.still_column
        return whole_steps(self.rows_per_column * np.outer(self.times, columns) / step_px)

    def on_plane(self, positions: NDArray) -> NDArray[np.float64]:
        """Return the positions (T, 2) of a path, x and y in pixels, as x and y'."""
        x, y = positions.T
        return np.stack([x, y - self.rows_per_column * self.times * (x - self.still_column)], 1)

    def slice(self, frames: builtins.slice) -> RangeDopplerCoupling:
        """Return the coupling of some successive frames, in the plane of them all."""
        return replace(self, times=self.times[frames])

    def travel(self, n_columns: int) -> NDArray[np.float64]:
        """Return the rows a target of constant Doppler moves through, for each pixel column."""
        span = float(np.ptp(self.times))
        return span * np.abs(self.rows_per_column * (np.arange(n_columns) - self.still_column))


def whole_steps(values: NDArray) -> NDArray[np.int32]:
    """Round half away from zero, so that opposite velocities move by opposite steps."""
    return (np.sign(values) * np.floor(np.abs(values) + 0.5)).astype(np.int32)
