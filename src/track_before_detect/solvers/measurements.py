"""Frames as dynamic programming over whole pixels sees them: through the PSF, psi and phi."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import matched_filter, transition_dp
from track_before_detect.models.psf import GaussianPsf

# Share of the peak below which the rim of a stamp is left out: a target narrower than 0.3 pixels
# is a single pixel.
LEAST_OF_PEAK = 0.005
# Stamps that overlap by more than this are taken for one position.
SAME_POSITION = 0.5
WHOLE = np.zeros((0, 0, 0), np.float32)


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

    @property
    def n_frames(self) -> int:
        """Frames of the batch."""
        return len(self.phi)

    def scores(self, merit: Merit) -> NDArray[np.float32]:
        """Return what each pixel adds to the merit function, shape (T, H, W)."""
        scores = np.empty(self.phi.shape, np.float32)
        _, n_y, n_x = self.phi.shape
        everything = np.tile([0, n_y, 0, n_x], (self.n_frames, 1))
        transition_dp.score_pixels(scores, self.psi, self.phi, everything, merit.squared,
                                   merit.signed)
        return scores


def measure(frames: NDArray, psf: GaussianPsf) -> Measurements:
    """See frames through a PSF.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Frames of unit noise (E|n|^2 = 1 for complex ones); not finite where masked.
    psf : GaussianPsf
        What a target looks like.
    """
    taps = _profile(psf, 0.0).astype(np.float32)
    valid = np.isfinite(frames)
    whole = bool(valid.all())
    clean = frames if whole else np.where(valid, frames, 0)
    parts = [clean.real, clean.imag] if np.iscomplexobj(frames) else [clean]
    psi = np.stack([_correlate(part, taps) for part in parts])
    shown = np.ones((1, *frames.shape[1:])) if whole else valid
    phi = np.broadcast_to(_correlate(shown, taps**2), frames.shape)
    weights = WHOLE if whole else valid.astype(np.float32)
    return Measurements(psi, np.ascontiguousarray(phi), weights, np.outer(taps, taps))


def cores(psf: GaussianPsf) -> NDArray[np.float32]:
    """Return the largest statistic of a target that leaves each pixel around it in use.

    A target half a pixel off in x and y has an amplitude fitted in the middle of its pixel; what
    that leaves in pixels around may not pass the noise. Pixels whose stamps overlap by more than
    a half with that of the target are not left in use at all, as those of one position are not.

    Returns
    -------
    array, shape (2 K - 1, 2 K - 1)
        For a stamp of K x K pixels; the target is in the middle.
    """
    middle, aside = _profile(psf, 0.0), _profile(psf, 0.5)
    half = len(middle) - 1
    if half == 0:
        return np.full((1, 1), -1, np.float32)
    same = _overlaps(middle, middle, half)
    overlap = np.outer(same, same)
    left = np.zeros(overlap.shape)
    for x in (aside, aside[::-1]):
        for y in (aside, aside[::-1]):
            seen = np.outer(_overlaps(y, middle, half), _overlaps(x, middle, half))
            # An amplitude of one is fitted, whatever it takes.
            left = np.maximum(left, np.abs(seen / seen[half, half] - overlap))
    return np.where(overlap > SAME_POSITION, -1.0, 1 / np.maximum(left, 1e-9)).astype(np.float32)


def _profile(psf, phase):
    """Return the unit-norm profile without its faint rim; that of ``phase`` 0 sets the length."""
    kept = np.flatnonzero(psf.taps(0.0) > LEAST_OF_PEAK * psf.taps(0.0).max())
    profile = psf.taps(phase)[kept[0]:kept[-1] + 1]
    return profile / np.linalg.norm(profile)


def _overlaps(moved, profile, half):
    """Return the inner product of two profiles for shifts of -half to half pixels."""
    return np.correlate(np.pad(moved, half), profile, 'valid')


def _correlate(frames, taps):
    """Return the correlation of each frame with a separable stamp."""
    out = np.empty(frames.shape, np.float32)
    ones_y, ones_x = np.ones(frames.shape[1], np.float32), np.ones(frames.shape[2], np.float32)
    for frame, result in zip(np.ascontiguousarray(frames, np.float32), out, strict=True):
        matched_filter.filter_frame(result, frame, taps[None], ones_y, ones_x, 0, len(frame))
    return out
