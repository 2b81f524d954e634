"""What each position of the grid adds to the value of a path: the matched filter and its scores.

The filter is a sum of separable components, so a PSF of any shape costs a few times a Gaussian
(Patent Eq. 16: the terms that the path search adds up).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE
from track_before_detect.kernels.scores import matched_filter
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import (
    frame_of,
    grid_shape,
    NO_FRAMES,
    NOTHING,
    OverRows,
    Scores,
)

if TYPE_CHECKING:
    from track_before_detect.models.measurement.psf import Psf


class PsfScores(Scores):
    """Scores of all positions of a grid in frames of one size.

    Parameters
    ----------
    psf : Psf
        What a target looks like; its oversampling is the grid's.
    shape, amplitudes, over_rows
        As for ``MeasurementModel.scores``.
    """

    can_renew = True

    def __init__(self, psf: Psf, shape: tuple[int, int], amplitudes: AmplitudeModel,
                 over_rows: OverRows):
        self._model = amplitudes
        self._over_rows = over_rows
        n_sub = psf.oversampling
        rank = psf.filter_rank
        taps = np.array([[psf.profiles(axis, phase / n_sub)[0][:rank] for phase in range(n_sub)]
                         for axis in (0, 1)])
        # (axis, phase, component, tap) to (component, axis, phase, tap).
        taps = np.ascontiguousarray(taps.transpose(2, 0, 1, 3))
        if rank == 1:
            taps /= np.linalg.norm(taps, axis=3, keepdims=True)
        self._taps = taps.astype(np.float32)
        self.grid_shape = grid_shape(psf, shape)
        self._ones: list[NDArray] = [np.ones(n, np.float32) for n in self.grid_shape]
        self._level = (1 / np.sqrt(_norms_squared(taps))).astype(np.float32)
        self._weights: NDArray = NO_FRAMES
        # What weights and border leave of the squared norm of the PSF, None without weights.
        self._shares: NDArray | None = None
        if rank == 1:
            self._scales: list[NDArray] = [
                1 / np.sqrt(_shares_in_line(taps[0, axis], shape[axis], n_sub))
                for axis in (0, 1)]
            self._border = NO_FRAMES
        else:
            self._border = self._shares_of(np.ones((1, *shape), np.float32))

    def set_weights(self, weights: NDArray | None) -> None:
        """Tell one over the noise of each pixel; see :class:`Scores`."""
        if weights is None:
            self._weights, self._shares = NO_FRAMES, None
        else:
            self._weights = np.ascontiguousarray(weights, np.float32)
            self._shares = self._shares_of(self._weights**2)
        self.squares = self._squares()

    def _squares(self) -> NDArray[np.float32] | None:
        """Return n^2 of each position."""
        if self._shares is None or not self._model.is_constant:
            return None
        return np.where(self._shares > LEAST_SHARE, self._shares, np.float32(0))

    def scores(self, frames: NDArray, factor: float | None = None,
               tilt: float = 0.0) -> NDArray[np.float32]:
        """Return what every position adds to the value of a path, shape (T, Y, X)."""
        scores = np.empty((len(frames), *self.grid_shape), np.float32)
        self._fill(scores, frames, np.ones(scores.shape[:2], bool), factor, tilt)
        return scores

    def renew(self, scores: NDArray, frames: NDArray, changed: NDArray) -> NDArray[np.bool_]:
        """Bring scores (T, Y, X) up to date after some rows of pixels have changed."""
        half = self._taps.shape[3] // 2
        n_sub = self._taps.shape[2]
        padded = np.pad(changed, ((0, 0), (half, half)))
        near = sliding_window_view(padded, 2 * half + 1, axis=1).any(axis=2)
        rows = np.repeat(near, n_sub, axis=1)[:, :self.grid_shape[0]]
        self._fill(scores, frames, rows)
        return rows

    def _fill(self, scores: NDArray, frames: NDArray, rows: NDArray,
              factor: float | None = None, tilt: float = 0.0) -> None:
        """Write the marked ``rows`` (T, Y) of the scores."""
        n_frames = len(frames)
        weighted = self._shares is not None
        uneven = weighted and self._model.is_constant and factor is not None
        factor = n_frames**-0.5 if factor is None else factor
        shares = self._border if self._shares is None else self._shares
        if weighted or len(self._border):
            scales = self._ones
        else:
            scales = self._scales
        if np.iscomplexobj(frames):
            real, imaginary = frames.real.copy(), frames.imag.copy()
        else:
            real, imaginary = frames.view(), np.empty((n_frames, 0, 0), np.float32)
        # Arrays that may be written are another type: the loop would be compiled for both.
        real.flags.writeable = imaginary.flags.writeable = False

        def fill(first: int, last: int) -> None:
            for t in range(n_frames):
                matched_filter.scores_of_frame(
                    scores[t], real[t], imaginary[t], frame_of(self._weights, t),
                    frame_of(shares, t), uneven, self._taps, self._level, *scales,
                    self._model.code, factor, tilt, rows[t], first, last)

        self._over_rows(fill)

    def _shares_of(self, squared_weights: NDArray) -> NDArray[np.float32]:
        """Return the squared norm that weights leave of the PSF over that of the whole, float32.

        The square of a sum of components is a sum over pairs of them.
        """
        n = len(self._taps)
        pairs = [(c, d) for c in range(n) for d in range(c + 1)]
        taps = np.array([self._taps[c] * self._taps[d] for c, d in pairs])
        taps[:, 0] *= np.array([1.0 if c == d else 2.0 for c, d in pairs])[:, None, None]
        shares = np.empty((len(squared_weights), *self.grid_shape), np.float32)
        # Of the type of the frames in ``_fill``.
        squared_weights.flags.writeable = False

        def fill(first: int, last: int) -> None:
            for share, weights in zip(shares, squared_weights, strict=True):
                matched_filter.filter_frame(share, weights, NOTHING, taps, self._level**2,
                                            *self._ones, first, last)

        self._over_rows(fill)
        return shares


def _norms_squared(taps: NDArray) -> NDArray:
    """Return the squared norm of the whole stamp for each position within a pixel, (S, S)."""
    in_y = np.einsum('csk,dsk->cds', taps[:, 0], taps[:, 0])
    in_x = np.einsum('csk,dsk->cds', taps[:, 1], taps[:, 1])
    return np.einsum('cdy,cdx->yx', in_y, in_x)


def _shares_in_line(taps: NDArray, length: int, n_sub: int) -> NDArray[np.float32]:
    """Return the share of the squared norm of a profile (S, K) left inside, per position."""
    half = taps.shape[1] // 2
    shares = np.empty((length - 1) * n_sub + 1, np.float32)
    for position in range(len(shares)):
        centre, phase = divmod(position, n_sub)
        pixel = np.arange(centre - half, centre + half + 1)
        shares[position] = np.sum(taps[phase, (pixel >= 0) & (pixel < length)]**2)
    return shares
