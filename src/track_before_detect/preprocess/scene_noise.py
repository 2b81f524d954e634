"""Noise that follows the scene: bright pixels count more photons, slopes show what has moved.

The variance of a pixel is fitted as a + b I + c |grad I|^2, with the background I. The shot noise
of a photon count is the term with b; what is left of motion, where the registration is off by a
little or leaves are in the wind, that with c. One fit serves all pixels, so that no target,
however slowly it moves, has a say in the noise of its own place.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from track_before_detect.kernels.pictures.scene_noise import noise_at, terms_at
from track_before_detect.preprocess.per_frame import each_frame

_PIXELS = 30_000  # of a batch that are fitted
_LEAST_PIXELS = 1000
_ROUNDS = 10  # of the fit, in each of which outlying pixels count as much as at the border
_OUTLYING = 3.0  # deviations beyond which a pixel belongs to a target, or to no model
_CUT = 1 / 0.973  # over the mean of squares of normal numbers that are cut there
_MEDIAN_OF_SQUARES = 0.455  # of normal numbers
_DARK = 0.01  # share of the pixels that is darker than where a count of photons begins
_LEAST_SHARE = 1e-6  # of the mean variance, below which no pixel is taken to be


def scene_noise(residual: NDArray, frames: NDArray) -> NDArray[np.float32] | None:
    """Return how the noise of pixels differs by the brightness and the slopes of the scene.

    Parameters
    ----------
    residual : array, shape (T, H, W)
        Real frames without background, NaN where masked.
    frames : array, shape (T, H, W)
        The same with it.

    Returns
    -------
    array of float32, shape (T, H, W), or None
        Deviation of the noise, with a median of one, NaN where masked; None where nothing is
        known of it.
    """
    n_pixels = residual[0].size
    step = max(residual.size // _PIXELS, 1)
    # Not the same pixels in every frame.
    terms = np.concatenate(each_frame(
        lambda frame, left, first: _terms(frame, left, first, step), frames, residual,
        [(-t * n_pixels) % step for t in range(len(frames))]))
    terms = terms[np.isfinite(terms).all(axis=1)]
    if len(terms) < _LEAST_PIXELS:
        return None
    dark = float(np.quantile(terms[:, 1], _DARK))
    factors = _fitted(terms[:, 0], np.column_stack([
        np.ones(len(terms)), np.maximum(terms[:, 1] - dark, 0.0), terms[:, 2]]))
    if factors is None:
        return None
    noise = np.empty(residual.shape, np.float32)
    least = _LEAST_SHARE * float(np.mean(terms[:, 0]))
    each_frame(lambda frame, left, out: noise_at(frame, left, dark, factors, least, out),
               frames, residual, noise)
    noise /= np.nanmedian(noise[:, ::4, ::4])
    return noise


def _terms(frame: NDArray, residual: NDArray, first: int, step: int) -> NDArray[np.float64]:
    out = np.empty((max(-(-(frame.size - first) // step), 0), 3))
    terms_at(frame, residual, first, step, out)
    return out


def _fitted(power: NDArray, terms: NDArray) -> NDArray[np.float64] | None:
    """Return factors of at least zero that make ``terms @ factors`` the mean of the powers.

    Each round weighs pixels by the variance of the one before, and cuts powers beyond it.
    """
    sizes = np.maximum(terms.mean(axis=0), np.finfo(float).tiny)
    # One term after the other: sums over all pixels are then of neighbours in memory.
    scaled = np.ascontiguousarray((terms / sizes).T)
    variance = np.full(len(power), float(np.median(power)) / _MEDIAN_OF_SQUARES)
    for _ in range(_ROUNDS):
        if not variance[0] > 0:
            return None
        seen = _CUT * np.minimum(power, _OUTLYING**2 * variance)
        found = _least_squares(scaled / variance, seen / variance)
        variance = np.maximum(np.einsum('pn,p->n', scaled, found), _LEAST_SHARE * found.sum())
    return found / sizes


def _least_squares(terms: NDArray, values: NDArray) -> NDArray[np.float64]:
    """Return factors of at least zero by which terms (P, N) are nearest to values (N,).

    By the normal equations, without BLAS: its threads would wait for cores on which the batch
    before is searched, many times as long as these few sums take.
    """
    strengths, axes = np.linalg.eigh(np.einsum('pn,qn->pq', terms, terms))
    roots = np.sqrt(np.maximum(strengths, np.finfo(float).eps * strengths[-1]))
    right = axes.T @ np.einsum('pn,n->p', terms, values)
    return nnls(roots[:, None] * axes.T, right / roots)[0]
