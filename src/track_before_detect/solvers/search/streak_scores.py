"""What each position adds to the value of a path that leaves a streak of one of several shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.scores import matched_filter
from track_before_detect.kernels.scores.streak_scores import scores_of_streak
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.streak import StreakPsf
from track_before_detect.solvers.search.position_scores import (
    frame_of,
    NOTHING,
    OverRows,
    PositionScores,
)


class StreakScores(PositionScores):
    """Scores of all positions for each of several streaks.

    The velocity of a path chooses among them. Streaks are sums over grid positions, and their norm
    beside borders and masks is that of a mean share: the path that is found is weighed exactly
    when it is added.

    Parameters
    ----------
    psf : StreakPsf
        Its oversampling is the grid's.
    shape, model, over_rows
        As for PositionScores; amplitudes that are not constant.
    streaks : array, shape (C, 2)
        x and y in pixels, from one end to the other.
    """

    def __init__(self, psf: StreakPsf, shape: tuple[int, int], model: AmplitudeModel,
                 over_rows: OverRows, streaks: NDArray):
        super().__init__(psf.base, shape, model, over_rows)
        self._whole = self._shares_of(np.ones((1, *shape), np.float32))
        n_sub = psf.oversampling
        self._places = [places_along(streak * n_sub) for streak in streaks]
        self._factors = [self._factors_of(places, n_sub) for places in self._places]

    def scores(self, frames: NDArray, factor: float | None = None, tilt: float = 0.0) -> NDArray:
        """Return what every position adds to the value of a path, shape (C * T, Y, X).

        All frames of the first streak come first.
        """
        n_frames = len(frames)
        shares = self._whole if self.shares is None else self.shares
        scores = np.empty((len(self._places) * n_frames, *self._grid_shape), np.float32)
        parts = (frames.real, frames.imag) if np.iscomplexobj(frames) else (frames,)
        filtered = [np.empty(self._grid_shape, np.float32) for _ in parts]
        for t in range(n_frames):
            weights = frame_of(self._weights, t)
            for part, out in zip(parts, filtered, strict=True):
                self._over_rows(self._filling(out, np.ascontiguousarray(part[t]), weights))
            imaginary = filtered[1] if len(parts) == 2 else NOTHING
            for c, (places, factors) in enumerate(zip(self._places, self._factors, strict=True)):
                self._over_rows(self._summing(scores[c * n_frames + t], filtered[0], imaginary,
                                              frame_of(shares, t), places, factors))
        return scores

    def _filling(self, out, frame, weights):
        def fill(first, last):
            matched_filter.filter_frame(out, frame, weights, self._taps, self._level,
                                        *self._ones, first, last)
        return fill

    def _summing(self, out, real, imaginary, shares, places, factors):
        def fill(first, last):
            scores_of_streak(out, real, imaginary, shares, places, factors, self._model.code,
                             first, last)
        return fill

    def _factors_of(self, places, n_sub):
        """Return one over the norm of the sum of stamps at ``places`` by middle, (S, S)."""
        n_taps = self._taps.shape[3]
        reach = int(np.abs(places).max()) // n_sub + 2
        factors = np.empty((n_sub, n_sub), np.float32)
        for middle in np.ndindex(n_sub, n_sub):
            picture = np.zeros((n_taps + 2 * reach, n_taps + 2 * reach))
            for x, y in places:
                row, phase_y = divmod(middle[0] + y, n_sub)
                column, phase_x = divmod(middle[1] + x, n_sub)
                stamp = np.einsum('ci,ck->ik', self._taps[:, 0, phase_y],
                                  self._taps[:, 1, phase_x])
                picture[reach + row:reach + row + n_taps,
                        reach + column:reach + column + n_taps] += (
                    stamp * self._level[phase_y, phase_x])
            factors[middle] = 1 / np.linalg.norm(picture)
        return factors


def places_along(streak: NDArray) -> NDArray[np.int64]:
    """Return the grid positions (M, 2) along a streak (x, y) in grid steps, around its middle."""
    n_places = max(1, int(np.ceil(np.hypot(*streak))))
    at = (np.arange(n_places) + 0.5) / n_places - 0.5
    return np.rint(at[:, None] * streak).astype(np.int64)
