"""How the amplitude of a target may change from frame to frame, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.amplitude_codes import (
    COMPLEX,
    COMPLEX_CONSTANT,
    CONSTANT,
    NON_NEGATIVE,
    SIGNED,
    SIGNED_CONSTANT,
)

__all__ = ['COMPLEX', 'COMPLEX_CONSTANT', 'CONSTANT', 'NON_NEGATIVE', 'SIGNED', 'SIGNED_CONSTANT',
           'AmplitudeModel']


# Paths whose value on the grid is below this share of the threshold's are not looked at closely,
# however much they may gain: with a low threshold there would be no end of them.
LEAST_SHARE = 0.8


@dataclass(frozen=True)
class AmplitudeModel:
    """One model of the amplitudes x of a path, with the statistic eta that goes with it.

    ================ =================================== ==================================
    code             x                                   eta
    ================ =================================== ==================================
    NON_NEGATIVE     x_t >= 0, any value in each frame   square root of sum of max(h, 0)^2
    SIGNED           any value in each frame             square root of sum of h^2
    COMPLEX          any complex number in each frame    square root of sum of |h|^2
    CONSTANT         x_t = alpha n_t / |n|, alpha >= 0   max(sum of n h, 0) / |n|
    SIGNED_CONSTANT  the same with alpha of either sign  magnitude of sum of n h / |n|
    COMPLEX_CONSTANT |x_t| = alpha n_t / |n|, any phase  sum of n |h| / |n|
    ================ =================================== ==================================

    The first two constant models are a restriction to one dimension, so their statistic has the
    noise of one number instead of T: they find dimmer targets, and miss those that fluctuate. A
    phase that is free in each frame leaves most of the noise in.

    Moduli that are constant are no convex set; the largest norm of which eta is the dual is
    max |x_t| |n| / n_t, equal to |x| on that set. It takes the place of |x| at t = 1, where moduli
    are merely bounded by it, and makes that problem the convex hull of the others.

    What is constant is the amplitude of the target itself: n_t, the norm that variance and mask of
    frame t leave of its stamp, says how much of it the unit-norm column shows. Where neither is
    given all n_t are one, also beside the border, so that the statistic, the sum of h over
    sqrt(T), is additive along a path.

    Attributes
    ----------
    code : int
        One of the codes above.
    """

    code: int

    @classmethod
    def named(cls, amplitudes: str, amplitude_model: str) -> AmplitudeModel:
        """Return the model for two options of the detector."""
        if amplitude_model == 'constant':
            return cls({'signed': SIGNED_CONSTANT, 'complex': COMPLEX_CONSTANT}.get(
                amplitudes, CONSTANT))
        return cls({'signed': SIGNED, 'complex': COMPLEX}.get(amplitudes, NON_NEGATIVE))

    @property
    def is_constant(self) -> bool:
        """Whether one amplitude, or its modulus, serves all frames."""
        return self.code in (CONSTANT, SIGNED_CONSTANT, COMPLEX_CONSTANT)

    @property
    def is_complex(self) -> bool:
        """Whether frames and amplitudes are complex, the noise with E|n|^2 = 1."""
        return self.code in (COMPLEX, COMPLEX_CONSTANT)

    @property
    def has_one_modulus(self) -> bool:
        """Whether the modulus is the same in all frames and the phase free."""
        return self.code == COMPLEX_CONSTANT

    @property
    def signs(self) -> tuple[int, ...]:
        """Signs that one amplitude for all frames may have."""
        return (1, -1) if self.code == SIGNED_CONSTANT else (1,)

    def n_numbers(self, n_frames: int) -> int:
        """Return of how many real numbers the amplitudes of a path are made."""
        return (1 if self.is_constant else n_frames) + n_frames * self.is_complex

    @property
    def turn_cost(self) -> float:
        """Cost of a change of either velocity component by one step, in units of a value.

        That of one modulus is worth as much at the threshold as that of complex amplitudes which
        fluctuate, 3 / (2 eta): then 95 % of crossing pairs (SNR 3, 0.5 px a frame apart, 40 runs)
        are found and told apart, with half of it 88 %. Half of it would find two more of 100 dim
        targets (SNR 1.4 in 64 x 64 pixels, 400 runs), which is less than it costs.
        """
        if self.has_one_modulus:
            return 0.2
        return 0.5 if self.is_constant else 3.0

    @property
    def refinement_gain(self) -> float:
        """What the value of a path on the grid may gain by moving off it, but for one in fifty.

        Measured on targets near the threshold (20 frames): 425 real ones that fluctuate, 128
        complex ones, 212 of constant amplitude and 150 of one modulus. One in eight of the first
        gains more than 8.
        """
        if self.is_constant:
            return 0.7 if self.has_one_modulus else 0.9
        return 7.0 if self.is_complex else 12.0

    def envelope(self, norms: NDArray) -> NDArray[np.float64]:
        """Return n / |n|, in proportion to which the x_t of a constant amplitude are, (T,).

        Parameters
        ----------
        norms : array, shape (T,)
            n_t; of a path that is hidden in every frame the result is zero.
        """
        return norms / max(float(np.linalg.norm(norms)), 1e-300)

    def best(self, seen: NDArray, envelope: NDArray) -> NDArray:
        """Return the amplitudes that fit the statistic of each frame best, shape (T,)."""
        if self.has_one_modulus:
            return self.statistic(seen, envelope) * envelope * np.exp(1j * np.angle(seen))
        if self.is_constant:
            alpha = float(seen @ envelope)
            return envelope * (max(alpha, 0.0) if self.code == CONSTANT else alpha)
        return np.maximum(seen, 0) if self.code == NON_NEGATIVE else seen.copy()

    def statistic(self, seen: NDArray, envelope: NDArray) -> float:
        """Return eta for the matched filter statistic h of each frame, shape (T,)."""
        if self.has_one_modulus:
            return float(np.abs(seen) @ envelope)
        if self.is_constant:
            alpha = float(seen @ envelope)
            return max(alpha, 0.0) if self.code == CONSTANT else abs(alpha)
        return float(np.linalg.norm(np.maximum(seen, 0) if self.code == NON_NEGATIVE else seen))

    def rectified(self, seen: NDArray) -> NDArray:
        """Return statistics h (T,) with the sign of the target taken off, magnitudes if free."""
        if self.code in (NON_NEGATIVE, CONSTANT):
            return seen
        if self.code == SIGNED_CONSTANT:
            return seen * (np.sign(seen.sum()) or 1.0)
        return np.abs(seen)

    def norms(self, amplitudes: NDArray, envelopes: NDArray) -> NDArray[np.float64]:
        """Return the norm that shrinks the amplitudes (P, T) of each path, shape (P,)."""
        if self.has_one_modulus:
            return np.max(np.abs(amplitudes) / np.where(envelopes > 0, envelopes, np.inf), axis=1)
        return np.linalg.norm(amplitudes, axis=1)

    def snr(self, seen: NDArray) -> float:
        """Return the mean statistic of one frame: of |h| where it is complex."""
        return float(np.mean(np.abs(seen) if self.is_complex else seen))

    def weight(self, threshold: float, cost: float) -> float:
        """Return lambda of a path whose turns cost ``cost``: what its statistic has to pass.

        Values add up along a path, so costs add to them: lambda^2 = threshold^2 + cost for the
        squared statistics, lambda = threshold + cost for the constant models, the cost then
        multiplied by :meth:`cost_scale`.
        """
        if self.is_constant:
            return threshold + cost
        return math.sqrt(threshold**2 + cost)

    def cost_scale(self, norms: NDArray) -> float:
        """Return sqrt(T) / |n|, by which the turns of a constant amplitude cost more.

        With a cost that grows as less is seen of a target, sum of n h less cost stays additive.
        """
        if not self.is_constant:
            return 1.0
        return math.sqrt(len(norms)) / max(float(np.linalg.norm(norms)), 1e-300)

    def grid_level(self, threshold: float) -> float:
        """Return the value from which on a path of the grid may pass the threshold off it."""
        value = self.value(threshold)
        return max(value - self.refinement_gain, LEAST_SHARE * value)

    def value(self, statistic: float) -> float:
        """Return the value, additive along a path, of a path without turns."""
        return statistic if self.is_constant else statistic**2

    def from_value(self, value: float) -> float:
        """Return the statistic of a path without turns that has this value."""
        return max(value, 0.0) if self.is_constant else math.sqrt(max(value, 0.0))
