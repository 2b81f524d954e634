"""An exhaustive search over straight lines, the yardstick for dim targets.

All centres on a grid of half pixels and all velocities up to a speed, so close together that a
line is off its neighbour by at most half a pixel at the ends. No code is shared with the
detectors.
"""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.studies.dim.straight_lines import best_line_near, best_lines

# Places per pixel.
GRID = 2


class LineFilter:
    """Matched filter for targets of unknown place and constant velocity in unit white noise.

    Parameters
    ----------
    n_frames : int
        Frames of a batch, at least 2.
    max_speed_px : float
        Largest speed in pixels per frame.
    sigma_px : float
        Of the Gaussian point spread function.
    model : str
        ``"constant"``: the statistic of a path is sum h / sqrt(T); ``"fluctuating"``:
        sqrt(sum [h]_+^2), h being the matched filter statistic.
    """

    def __init__(self, n_frames: int, max_speed_px: float, sigma_px: float, model: str):
        if model not in ('constant', 'fluctuating'):
            raise ParameterError(f'model must be constant or fluctuating, got {model!r}')
        self._constant = model == 'constant'
        self._sigma = sigma_px
        self._times = np.arange(n_frames) - 0.5 * (n_frames - 1)
        step = 1.0 / (n_frames - 1)
        count = int(np.floor(max_speed_px / step + 1e-9))
        axis = step * np.arange(-count, count + 1)
        velocities = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        self._velocities = velocities[np.hypot(*velocities.T) <= max_speed_px + 1e-9]
        self._offsets = np.rint(
            GRID * self._velocities[:, None] * self._times[:, None]).astype(np.int64)

    def best(self, frames: NDArray) -> float:
        """Return the largest statistic of any path that stays inside; frames (T, H, W)."""
        scores = self._scores(frames)
        best = np.empty(len(self._offsets), np.float32)
        best_lines(scores, self._offsets, np.empty(scores.shape[2], np.float32), best)
        return self._statistic(float(best.max()))

    def best_near(self, frames: NDArray, truth: NDArray, limit_px: float) -> float | None:
        """Return the largest statistic of a path less than ``limit_px`` from a target on average.

        Parameters
        ----------
        frames : array, shape (T, H, W)
        truth : array, shape (T, 2)
            Positions of the target.
        limit_px : float

        Returns
        -------
        float
            None where no path of the search is that near.
        """
        scores = self._scores(frames)
        middle = np.rint(GRID * truth.mean(axis=0)).astype(np.int64)
        reach = np.arange(-int(np.ceil(GRID * limit_px)), int(np.ceil(GRID * limit_px)) + 1)
        centres = middle + np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
        # On average a line is off its neighbour by at least the difference of their velocities
        # times the mean time, so those farther off than this are not near the target either.
        slope = self._times @ truth / (self._times @ self._times)
        bend = np.linalg.norm(truth - truth.mean(axis=0) - self._times[:, None] * slope, axis=1)
        spread = (limit_px + bend.mean()) / np.abs(self._times).mean()
        near = np.hypot(*(self._velocities - slope).T) <= spread
        best = best_line_near(scores, self._offsets[near], centres, GRID * truth,
                              GRID * limit_px)
        return self._statistic(best) if np.isfinite(best) else None

    def _scores(self, frames: NDArray) -> NDArray[np.float32]:
        """Return what adds up along a path on the grid, shape (T, GRID (H - 1) + 1, ...)."""
        _, height, width = frames.shape
        rows = _filter_matrix(height, self._sigma)
        columns = _filter_matrix(width, self._sigma)
        h = (rows @ frames @ columns.T).astype(np.float32)
        return h if self._constant else np.maximum(h, 0)**2

    def _statistic(self, total: float) -> float:
        return total / len(self._times)**0.5 if self._constant else max(total, 0.0)**0.5


def _filter_matrix(side: int, sigma: float) -> NDArray[np.float32]:
    """Return unit-norm Gaussian stamps at all places of one axis, cut at the border."""
    places = np.arange(GRID * (side - 1) + 1) / GRID
    stamps = np.exp(-0.5 * ((np.arange(side) - places[:, None]) / sigma)**2)
    return (stamps / np.linalg.norm(stamps, axis=1, keepdims=True)).astype(np.float32)
