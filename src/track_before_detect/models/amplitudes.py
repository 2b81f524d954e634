"""How the amplitude of a target may change from frame to frame, and what follows from it.

====================== =================================== ==================================
model                  amplitudes x of a path              statistic eta
====================== =================================== ==================================
NonNegative            x_t >= 0, any value in each frame   square root of sum of max(h, 0)^2
Signed                 any value in each frame             square root of sum of h^2
Complex                any complex number in each frame    square root of sum of |h|^2
Constant               x_t = alpha n_t / |n|, alpha >= 0   max(sum of n h, 0) / |n|
SignedConstant         the same with alpha of either sign  magnitude of sum of n h / |n|
ComplexConstant        |x_t| = alpha n_t / |n|, any phase  sum of n |h| / |n|
====================== =================================== ==================================

What is constant is the amplitude of the target itself: n_t, the norm that variance and mask of
frame t leave of its stamp, says how much of it the unit-norm column shows. Where neither is given
all n_t are one, also beside the border, so that the statistic, the sum of h over sqrt(T), is
additive along a path.
"""

from abc import ABC, abstractmethod
import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import amplitude_codes

# Paths whose value on the grid is below this share of the threshold's are not looked at closely,
# however much they may gain: with a low threshold there would be no end of them.
LEAST_SHARE = 0.8


class AmplitudeModel(ABC):
    """One model of the amplitudes of a path, with the statistic eta that goes with it.

    Attributes
    ----------
    code : int
        Its code in compiled loops.
    is_constant : bool
        Whether one amplitude, or its modulus, serves all frames.
    is_complex : bool
        Whether frames and amplitudes are complex, the noise with E|n|^2 = 1.
    has_one_modulus : bool
        Whether the modulus is the same in all frames and the phase free.
    non_negative : bool
        Whether amplitudes are at least zero.
    signs : tuple of int
        Signs that one amplitude for all frames may have.
    turn_cost : float
        Cost of a change of either velocity component by one step, in units of a value
        (docs/constants/models.md).
    refinement_gain : float
        What the value of a path on the grid may gain by moving off it, but for one in fifty
        (docs/constants/models.md).
    frame_cost, end_cost : float
        Costs of being present in a frame, and of entering or leaving, in units of a value, see
        the module ``presence`` (docs/constants/models.md).
    """

    code: ClassVar[int]
    is_constant: ClassVar[bool]
    is_complex: ClassVar[bool] = False
    has_one_modulus: ClassVar[bool] = False
    non_negative: ClassVar[bool] = False
    signs: ClassVar[tuple[int, ...]] = (1,)
    turn_cost: ClassVar[float]
    refinement_gain: ClassVar[float]
    frame_cost: ClassVar[float]
    end_cost: ClassVar[float]

    def __repr__(self) -> str:
        """Return the text by which calibrations know the model."""
        return f'AmplitudeModel(code={self.code})'

    @abstractmethod
    def n_numbers(self, n_frames: int) -> int:
        """Return of how many real numbers the amplitudes of a path are made."""

    @abstractmethod
    def best(self, seen: NDArray, envelope: NDArray) -> NDArray:
        """Return the amplitudes that fit the statistic of each frame best, shape (T,)."""

    @abstractmethod
    def statistic(self, seen: NDArray, envelope: NDArray) -> float:
        """Return eta for the matched filter statistic h of each frame, shape (T,)."""

    @abstractmethod
    def rectified(self, seen: NDArray) -> NDArray:
        """Return statistics h (T,) with the sign of the target taken off, magnitudes if free."""

    def snr(self, seen: NDArray) -> float:
        """Return the mean statistic of one frame: of |h| where it is complex."""
        return float(np.mean(np.abs(seen) if self.is_complex else seen))

    def envelope(self, norms: NDArray) -> NDArray[np.float64]:
        """Return n / |n|, in proportion to which the x_t of a constant amplitude are, (T,).

        Parameters
        ----------
        norms : array, shape (T,)
            n_t; of a path that is hidden in every frame the result is zero.
        """
        return norms / max(float(np.linalg.norm(norms)), 1e-300)

    def norms(self, amplitudes: NDArray, envelopes: NDArray) -> NDArray[np.float64]:
        """Return the norm that shrinks the amplitudes (P, T) of each path, shape (P,)."""
        return np.linalg.norm(amplitudes, axis=1)

    @abstractmethod
    def penalty(self, threshold: float, cost: float) -> float:
        """Return lambda of a path whose turns cost ``cost``: what its statistic has to pass.

        Values add up along a path, so costs add to them: lambda^2 = threshold^2 + cost for squared
        statistics, otherwise lambda = threshold + cost times :meth:`cost_scale`.
        """

    @abstractmethod
    def cost_scale(self, norms: NDArray) -> float:
        """Return by how much more the turns of a path with these n (T,) cost."""

    @abstractmethod
    def value(self, statistic: float) -> float:
        """Return the value, additive along a path, of a path without turns."""

    @abstractmethod
    def from_value(self, value: float) -> float:
        """Return the statistic of a path without turns that has this value."""

    def grid_level(self, threshold: float) -> float:
        """Return the value from which on a path of the grid may pass the threshold off it."""
        value = self.value(threshold)
        return max(value - self.refinement_gain, LEAST_SHARE * value)


class _Fluctuating(AmplitudeModel):
    """Amplitudes of any value in each frame; squared statistics add up along a path."""

    is_constant = False
    turn_cost = 3.0
    end_cost = 6.0

    def n_numbers(self, n_frames: int) -> int:
        return n_frames * (1 + self.is_complex)

    def best(self, seen: NDArray, envelope: NDArray) -> NDArray:
        return np.maximum(seen, 0) if self.non_negative else seen.copy()

    def statistic(self, seen: NDArray, envelope: NDArray) -> float:
        return float(np.linalg.norm(self.best(seen, envelope)))

    def rectified(self, seen: NDArray) -> NDArray:
        return seen if self.non_negative else np.abs(seen)

    def penalty(self, threshold: float, cost: float) -> float:
        return math.sqrt(threshold**2 + cost)

    def cost_scale(self, norms: NDArray) -> float:
        return 1.0

    def value(self, statistic: float) -> float:
        return statistic**2

    def from_value(self, value: float) -> float:
        return math.sqrt(max(value, 0.0))


class NonNegative(_Fluctuating):
    """Any amplitude of at least zero in each frame."""

    code = amplitude_codes.NON_NEGATIVE
    non_negative = True
    refinement_gain = 12.0
    frame_cost = 1.4


class Signed(_Fluctuating):
    """Any real amplitude in each frame."""

    code = amplitude_codes.SIGNED
    refinement_gain = 12.0
    frame_cost = 2.0


class Complex(_Fluctuating):
    """Any complex amplitude in each frame."""

    code = amplitude_codes.COMPLEX
    is_complex = True
    refinement_gain = 7.0
    frame_cost = 1.5


class _OneAmplitude(AmplitudeModel):
    """One amplitude, or one modulus, for all frames; statistics add up along a path.

    One real amplitude is a restriction to one dimension, so its statistic has the noise of one
    number instead of T: it finds dimmer targets, and misses those that fluctuate.
    """

    is_constant = True
    turn_cost = 0.5
    refinement_gain = 0.9
    frame_cost = 0.0
    end_cost = 0.3

    def n_numbers(self, n_frames: int) -> int:
        return 1

    def best(self, seen: NDArray, envelope: NDArray) -> NDArray:
        alpha = float(seen @ envelope)
        return envelope * (max(alpha, 0.0) if self.non_negative else alpha)

    def statistic(self, seen: NDArray, envelope: NDArray) -> float:
        alpha = float(seen @ envelope)
        return max(alpha, 0.0) if self.non_negative else abs(alpha)

    def rectified(self, seen: NDArray) -> NDArray:
        return seen if self.non_negative else seen * (np.sign(seen.sum()) or 1.0)

    def penalty(self, threshold: float, cost: float) -> float:
        return threshold + cost

    def cost_scale(self, norms: NDArray) -> float:
        # With a cost that grows as less is seen, sum of n h less cost stays additive.
        return math.sqrt(len(norms)) / max(float(np.linalg.norm(norms)), 1e-300)

    def value(self, statistic: float) -> float:
        return statistic

    def from_value(self, value: float) -> float:
        return max(value, 0.0)


class Constant(_OneAmplitude):
    """One amplitude of at least zero."""

    code = amplitude_codes.CONSTANT
    non_negative = True


class SignedConstant(_OneAmplitude):
    """One real amplitude."""

    code = amplitude_codes.SIGNED_CONSTANT
    signs = (1, -1)


class ComplexConstant(_OneAmplitude):
    """One modulus and a phase that is free in each frame, which leaves most of the noise in.

    Moduli that are constant are no convex set; the largest norm of which eta is the dual is
    max |x_t| |n| / n_t, equal to |x| on that set. It takes the place of |x| at t = 1, where moduli
    are merely bounded by it, and makes that problem the convex hull of the others.
    """

    code = amplitude_codes.COMPLEX_CONSTANT
    is_complex = True
    has_one_modulus = True
    turn_cost = 0.2
    refinement_gain = 0.7

    def n_numbers(self, n_frames: int) -> int:
        """Return of how many real numbers the amplitudes of a path are made."""
        return 1 + n_frames

    def best(self, seen: NDArray, envelope: NDArray) -> NDArray:
        """Return the amplitudes that fit the statistic of each frame best, shape (T,)."""
        return self.statistic(seen, envelope) * envelope * np.exp(1j * np.angle(seen))

    def statistic(self, seen: NDArray, envelope: NDArray) -> float:
        """Return eta for the matched filter statistic h of each frame, shape (T,)."""
        return float(np.abs(seen) @ envelope)

    def rectified(self, seen: NDArray) -> NDArray:
        """Return the magnitudes of statistics h (T,)."""
        return np.abs(seen)

    def norms(self, amplitudes: NDArray, envelopes: NDArray) -> NDArray[np.float64]:
        """Return the norm that shrinks the amplitudes (P, T) of each path, shape (P,)."""
        return np.max(np.abs(amplitudes) / np.where(envelopes > 0, envelopes, np.inf), axis=1)


# By their codes in compiled loops.
AMPLITUDE_MODELS: tuple[AmplitudeModel, ...] = tuple(sorted(
    (NonNegative(), Signed(), Complex(), Constant(), SignedConstant(), ComplexConstant()),
    key=lambda model: model.code))


def amplitude_model(amplitudes: str, kind: str) -> AmplitudeModel:
    """Return the model for two options of the detector.

    Parameters
    ----------
    amplitudes : str
        ``"non-negative"``, ``"signed"`` or ``"complex"``.
    kind : str
        ``"constant"``, or ``"fluctuating"``: the option ``amplitude_model``.
    """
    fluctuating, constant = {
        'signed': (Signed, SignedConstant), 'complex': (Complex, ComplexConstant),
    }.get(amplitudes, (NonNegative, Constant))
    return constant() if kind == 'constant' else fluctuating()
