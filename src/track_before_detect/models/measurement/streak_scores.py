"""What each position adds to the value of a path that leaves a streak of one of several shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.kernels.scores import matched_filter
from track_before_detect.kernels.scores.streak_scores import scores_of_streak
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import frame_of, NOTHING, OverRows
from track_before_detect.models.measurement.psf_scores import PsfScores

if TYPE_CHECKING:
    from track_before_detect.models.measurement.streak import StreakPsf


class StreakScores(PsfScores):
    """Scores of all positions for each of several streaks.

    The velocity of a path chooses among them. Streaks are sums over grid positions, and their norm
    beside borders and masks is that of a mean share: the path that is found is weighed exactly
    when it is added. What is constant of a constant amplitude is that of the streak at unit norm,
    as of a target that keeps its speed.

    Parameters
    ----------
    psf : StreakPsf
        Its oversampling is the grid's.
    shape, amplitudes, over_rows
        As for ``MeasurementModel.scores``.
    streaks : array, shape (C, 2)
        x and y in pixels, from one end to the other.
    kinds : array of int, shape (V,)
        Which of them each velocity leaves.
    """

    can_renew = False

    def __init__(self, psf: StreakPsf, shape: tuple[int, int], amplitudes: AmplitudeModel,
                 over_rows: OverRows, streaks: NDArray, kinds: NDArray[np.int64]):
        super().__init__(psf.base, shape, amplitudes, over_rows)
        self.kinds = kinds
        self._whole = self._shares_of(np.ones((1, *shape), np.float32))
        n_sub = psf.oversampling
        self._places = [places_along(streak * n_sub) for streak in streaks]
        self._factors = [self._factors_of(places, n_sub) for places in self._places]

    def scores(self, frames: NDArray, factor: float | None = None,
               tilt: float = 0.0) -> NDArray[np.float32]:
        """Return what every position adds to the value of a path, shape (C * T, Y, X).

        All frames of the first streak come first.
        """
        n_frames = len(frames)
        uneven = self.squares is not None and factor is not None
        factor = n_frames**-0.5 if factor is None else factor
        shares = self._whole if self._shares is None else self._shares
        scores = np.empty((len(self._places), n_frames, *self.grid_shape), np.float32)
        parts = (frames.real, frames.imag) if np.iscomplexobj(frames) else (frames,)
        filtered = [np.empty(self.grid_shape, np.float32) for _ in parts]
        for t in range(n_frames):
            for part, out in zip(parts, filtered, strict=True):
                self._over_rows(
                    matched_filter.filter_frame, out, np.ascontiguousarray(part[t]),
                    frame_of(self._weights, t), self._taps, self._level, *self._ones)
            imaginary = filtered[1] if len(parts) == 2 else NOTHING
            for out, places, norms in zip(scores, self._places, self._factors, strict=True):
                self._over_rows(
                    scores_of_streak, out[t], NOTHING, filtered[0], imaginary,
                    frame_of(shares, t), places, norms, uneven, self._model.code, factor, tilt)
        return scores.reshape(-1, *self.grid_shape)

    def _squares(self) -> NDArray[np.float32] | None:
        """Return n^2 of each streak at each position."""
        if self._shares is None or not self._model.is_constant:
            return None
        squares = np.empty((len(self._places), *self._shares.shape), np.float32)
        unused = np.empty(self.grid_shape, np.float32)
        for left, places, norms in zip(squares, self._places, self._factors, strict=True):
            for own, share in zip(left, self._shares, strict=True):
                self._over_rows(scores_of_streak, unused, own, share, NOTHING, share, places,
                                norms, False, self._model.code, 1.0, 0.0)
        return np.where(squares > LEAST_SHARE, squares, np.float32(0)).reshape(
            -1, *self.grid_shape)

    def _factors_of(self, places: NDArray, n_sub: int) -> NDArray[np.float32]:
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
