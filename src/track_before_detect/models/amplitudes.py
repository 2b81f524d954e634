"""How the amplitude of a target may change from frame to frame, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.kernels.amplitude_codes import COMPLEX, CONSTANT, NON_NEGATIVE, SIGNED

__all__ = ['COMPLEX', 'CONSTANT', 'NON_NEGATIVE', 'SIGNED', 'AmplitudeModel']


@dataclass(frozen=True)
class AmplitudeModel:
    """One model of the amplitudes x of a path, with the statistic eta that goes with it.

    ============ =========================================== ==============================
    code         x                                           eta
    ============ =========================================== ==============================
    NON_NEGATIVE x_t >= 0, any value in each frame           square root of sum of max(h, 0)^2
    SIGNED       any value in each frame                     square root of sum of h^2
    COMPLEX      any complex number in each frame            square root of sum of |h|^2
    CONSTANT     one amplitude alpha >= 0, x_t = alpha/sqrt(T) sum of h over sqrt(T)
    ============ =========================================== ==============================

    The constant model is a restriction to one dimension, so its statistic has the noise of one
    number instead of T: it finds dimmer targets, and misses those that fluctuate. It is additive
    along a path only while all columns have equal norm; columns cut by a border or a mask are
    scaled to unit norm, which makes the amplitude that is taken as constant that of the scaled
    column.

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
            if amplitudes != 'non-negative':
                raise ParameterError(
                    'amplitude_model constant needs amplitudes non-negative, got '
                    f'{amplitudes!r}')
            return cls(CONSTANT)
        return cls({'signed': SIGNED, 'complex': COMPLEX}.get(amplitudes, NON_NEGATIVE))

    @property
    def is_constant(self) -> bool:
        """Whether one amplitude serves all frames."""
        return self.code == CONSTANT

    @property
    def is_complex(self) -> bool:
        """Whether frames and amplitudes are complex, the noise with E|n|^2 = 1."""
        return self.code == COMPLEX

    @property
    def turn_cost(self) -> float:
        """Cost of a change of either velocity component by one step, in units of a value."""
        return 0.5 if self.is_constant else 3.0

    def best(self, seen: NDArray) -> NDArray:
        """Return the amplitudes that fit the statistic of each frame best, shape (T,)."""
        if self.is_constant:
            return np.full(len(seen), max(float(np.mean(seen)), 0.0))
        return np.maximum(seen, 0) if self.code == NON_NEGATIVE else seen.copy()

    def statistic(self, seen: NDArray) -> float:
        """Return eta for the matched filter statistic h of each frame, shape (T,)."""
        if self.is_constant:
            return max(float(np.sum(seen)), 0.0) / math.sqrt(len(seen))
        return float(np.linalg.norm(np.maximum(seen, 0) if self.code == NON_NEGATIVE else seen))

    def snr(self, seen: NDArray) -> float:
        """Return the mean statistic of one frame: of |h| where it is complex."""
        return float(np.mean(np.abs(seen) if self.is_complex else seen))

    def weight(self, threshold: float, cost: float) -> float:
        """Return lambda of a path whose turns cost ``cost``: what its statistic has to pass.

        Values add up along a path, so costs add to them: lambda^2 = threshold^2 + cost for the
        squared statistics, lambda = threshold + cost for the constant model.
        """
        if self.is_constant:
            return threshold + cost
        return math.sqrt(threshold**2 + cost)

    def value(self, statistic: float) -> float:
        """Return the value, additive along a path, of a path without turns."""
        return statistic if self.is_constant else statistic**2

    def from_value(self, value: float) -> float:
        """Return the statistic of a path without turns that has this value."""
        return max(value, 0.0) if self.is_constant else math.sqrt(max(value, 0.0))
