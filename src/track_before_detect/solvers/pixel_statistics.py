"""Frames as dynamic programming over whole pixels sees them: through the PSF, psi and phi."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from track_before_detect.kernels import transition_dp
from track_before_detect.kernels.scores import matched_filter
from track_before_detect.models.measurement.psf import Psf

# Share of the peak below which the rim of a stamp is left out: a target narrower than 0.3 pixels
# is a single pixel.
LEAST_OF_PEAK = 0.005
# Stamps that overlap by more than this are taken for one position.
SAME_POSITION = 0.5
WHOLE = np.zeros((0, 0, 0), np.float32)
NOTHING = np.zeros((0, 0), np.float32)


@dataclass(frozen=True)
class Merit:
    """What a pixel adds to the merit function, from its matched filter statistic h.

    Attributes
    ----------
    squared : bool
        h^2 instead of h, for amplitudes that fluctuate; of real frames without ``signed`` only
        positive h count.
    signed : bool
        |h| instead of h. Complex frames always take |h|.
    """

    squared: bool
    signed: bool = False

    def statistic(self, value: float, n_frames: int) -> float:
        """Return the statistic of a path with this merit: its root, or the merit over root T."""
        return float(max(value, 0.0)**0.5 if self.squared else value / n_frames**0.5)

    def bound(self, statistic: float, n_frames: int) -> float:
        """Return the merit of a path with this statistic."""
        return statistic**2 if self.squared else statistic * n_frames**0.5


@dataclass(frozen=True)
class Measurements:
    """Frames, seen through the PSF.

    Attributes
    ----------
    psi : float32 array, shape (C, T, H, W)
        Data over variance seen through the PSF; C is 2 for the parts of complex frames, else 1.
    phi : float32 array, shape (T, H, W)
        Squared PSF over the variance.
    weights : float32 array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel, zero where masked; of no frames where it is one.
    stamp : float32 array, shape (K, K)
        Unit-norm PSF, K odd.
    """

    psi: NDArray[np.float32]
    phi: NDArray[np.float32]
    weights: NDArray[np.float32]
    stamp: NDArray[np.float32]

    def scores(self, merit: Merit) -> NDArray[np.float32]:
        """Return what each pixel adds to the merit function, shape (T, H, W)."""
        scores = np.empty(self.phi.shape, np.float32)
        transition_dp.score_pixels(scores, self.psi, self.phi, merit.squared, merit.signed)
        return scores


def measure(frames: NDArray, psf: Psf, weights: NDArray | None = None) -> Measurements:
    """See frames through a PSF.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Frames of unit noise (E|n|^2 = 1 for complex ones); not finite where masked.
    psf : Psf
        What a target looks like.
    weights : array, shape (T, H, W) or (1, H, W), optional
        One over the noise that each pixel had before it was scaled to one; one unless given.
    """
    taps = _components(psf)
    valid = np.isfinite(frames)
    whole = bool(valid.all())
    clean = frames if whole else np.where(valid, frames, 0)
    if weights is None:
        weights = WHOLE if whole else valid.astype(np.float32)
    elif not whole:
        weights = np.broadcast_to(weights, frames.shape) * valid
    weights = np.ascontiguousarray(weights, np.float32)
    visible = np.ones((1, *frames.shape[1:]), np.float32)
    if len(weights):
        clean, visible = clean * weights, weights**2
    parts = [clean.real, clean.imag] if np.iscomplexobj(frames) else [clean]
    psi = np.stack([_correlate(part, taps) for part in parts])
    phi = np.broadcast_to(_correlate(visible, _squared(taps)), frames.shape)
    stamp = np.einsum('ci,cj->ij', taps[:, 0], taps[:, 1])
    return Measurements(psi, np.ascontiguousarray(phi), weights, stamp.astype(np.float32))


def exclusion_levels(psf: Psf) -> NDArray[np.float32]:
    """Return the largest statistic of a target that leaves each pixel around it in use.

    A target half a pixel off in x and y has an amplitude fitted in the middle of its pixel; what
    that leaves in pixels around may not pass the noise. Pixels whose stamps overlap by more than
    a half with that of the target are not left in use at all, as those of one position are not.

    Returns
    -------
    array, shape (2 K - 1, 2 K - 1)
        For a stamp of K x K pixels; the target is in the middle.
    """
    half = _half_width(psf)
    if half == 0:
        return np.full((1, 1), -1, np.float32)
    middle = _stamp(psf, 0.0, 0.0, half)
    overlap = _overlaps(middle, middle)
    left = np.zeros(overlap.shape)
    for y in (-0.5, 0.5):
        for x in (-0.5, 0.5):
            seen = _overlaps(_stamp(psf, y, x, half), middle)
            # An amplitude of one is fitted, whatever it takes.
            left = np.maximum(left, np.abs(seen / seen[2 * half, 2 * half] - overlap))
    return np.where(overlap > SAME_POSITION, -1.0, 1 / np.maximum(left, 1e-9)).astype(np.float32)


def _overlaps(one: NDArray, other: NDArray) -> NDArray[np.float64]:
    """Return the inner products of two stamps of K x K pixels for all shifts that they meet in."""
    side = 2 * len(one) - 1
    # As scipy.signal does; to import it and scipy.stats took two fifths of the start of a node.
    shape = 2 * (fft.next_fast_len(side, real=True),)
    product = fft.rfft2(one, shape) * fft.rfft2(other[::-1, ::-1], shape)
    return fft.irfft2(product, shape)[:side, :side]


def _half_width(psf: Psf) -> int:
    """Return how far from the middle the stamp is more than its faint rim."""
    stamp = np.abs(_stamp(psf, 0.0, 0.0, psf.half_width))
    bright = np.argwhere(stamp > LEAST_OF_PEAK * stamp.max()) - psf.half_width
    return int(np.abs(bright).max())


def _stamp(psf: Psf, phase_y: float, phase_x: float, half: int) -> NDArray[np.float64]:
    """Return the unit-norm PSF around a position between the pixels, cut to a half width."""
    rows, columns = psf.profiles(0, phase_y)[0], psf.profiles(1, phase_x)[0]
    kept = slice(psf.half_width - half, psf.half_width + half + 1)
    stamp = np.einsum('ci,cj->ij', rows[:, kept], columns[:, kept])
    return stamp / np.linalg.norm(stamp)


def _components(psf: Psf) -> NDArray[np.float64]:
    """Return profiles (C, 2, K) in y and in x whose products add up to the unit-norm stamp."""
    half, rank = _half_width(psf), psf.filter_rank
    kept = slice(psf.half_width - half, psf.half_width + half + 1)
    taps = np.stack([psf.profiles(axis, 0.0)[0][:rank, kept] for axis in (0, 1)], axis=1)
    taps[:, 0] /= np.linalg.norm(np.einsum('ci,cj->ij', taps[:, 0], taps[:, 1]))
    return taps


def _squared(taps: NDArray) -> NDArray[np.float64]:
    """Return the components of the square of the stamp: the products of all pairs."""
    return (taps[:, None] * taps[None]).reshape(-1, *taps.shape[1:])


def _correlate(frames: NDArray, taps: NDArray) -> NDArray[np.float32]:
    """Return the correlation of each frame with a sum of separable components."""
    out = np.empty(frames.shape, np.float32)
    ones_y, ones_x = np.ones(frames.shape[1], np.float32), np.ones(frames.shape[2], np.float32)
    level = np.ones((1, 1), np.float32)
    in_place = np.ascontiguousarray(taps[:, :, None], np.float32)
    for frame, result in zip(np.ascontiguousarray(frames, np.float32), out, strict=True):
        matched_filter.filter_frame(result, frame, NOTHING, in_place, level, ones_y, ones_x, 0,
                                    len(frame))
    return out
