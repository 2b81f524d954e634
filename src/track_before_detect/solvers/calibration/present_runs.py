"""Paths of noise that are present in a run of the frames only.

Where targets may enter and leave, a path passes with whichever run of frames suits it best, so
runs add to the positions and velocities over which there are islands. One run differs from the
next by a frame, of which the statistic is a random walk rather than a smooth field: a run counts
where none that begins or ends at another frame is better. How often an end of a run is such a
one is known of the walk, for constant amplitudes by Siegmund (Sequential Analysis, 1985), for
others by Spitzer's identity for what the frames inside add.
"""

from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, gammainc, gammaln, ndtr

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.calibration.excursions import mixture

# Below it no level is of use.
LEAST = 1e-9
# What a frame adds to a path that may choose where to go on, more than to one that may not
# (docs/constants/calibration.md).
CHOICE = 0.5


class PresentRuns:
    """Runs of frames, those that are alike together.

    Parameters
    ----------
    n_frames : int
        T.
    model : AmplitudeModel
        Of the amplitudes.
    presence : Presence or None
        What runs cost; None where a path is there in every frame, which is one run.

    Attributes
    ----------
    lengths, ends, counts : array of int, shape (R,)
        Frames of each, how many of its two ends are inside the batch, and how many are alike.
    """

    def __init__(self, n_frames: int, model: AmplitudeModel, presence: Presence | None):
        self._n_frames, self._model, self._presence = n_frames, model, presence
        kinds = [(n_frames, 0, 1)]
        if presence is not None:
            kinds += [(length, 1, 2) for length in range(1, n_frames)]
            kinds += [(length, 2, n_frames - length - 1) for length in range(1, n_frames - 1)]
        self.lengths, self.ends, self.counts = np.array(kinds).T

    def levels(self, level: float) -> NDArray[np.float64]:
        """Return what the statistic of the frames of each has to pass, shape (R,)."""
        if self._presence is None:
            return np.array([level])
        value = self._model.value(level) - self._presence.whole_cost(self._n_frames)
        costs = self._presence.entry * self.ends
        if self._model.is_constant:
            return value + costs * np.sqrt(self._n_frames / self.lengths)
        return np.sqrt(np.maximum(value + self._presence.per_frame * self.lengths + costs, LEAST))

    def chances(self, levels: NDArray) -> NDArray[np.float64]:
        """Return how often no other run is better than one at these levels, shape (R,)."""
        if self._presence is None:
            return np.ones(1)
        if not self._model.is_constant:
            return self._all_pay(levels, self._presence.per_frame)**self.ends * self._stops
        step = levels / np.sqrt(self.lengths)
        density = np.exp(-step**2 / 8) / math.sqrt(2 * math.pi)
        return (step * (ndtr(step / 2) - 0.5)
                / (step / 2 * ndtr(step / 2) + density))**self.ends

    def _all_pay(self, levels: NDArray, cost: float) -> NDArray[np.float64]:
        """Return how often the last frames of a run, however many, add more than they cost."""
        levels, lengths = levels[:, None], self.lengths[:, None]
        numbers, often = mixture(lengths, constant=False, signed=not self._model.non_negative)
        # As the density of the norm has it, but for what all share.
        often = often * np.exp(numbers * np.log(levels / math.sqrt(2)) - gammaln(numbers / 2))
        dense = (often * numbers).sum(1, keepdims=True) / often.sum(1, keepdims=True) / lengths
        frames = np.arange(1.0, self._n_frames)[None]
        # What some of the numbers of a norm have of its square is a beta variable.
        less = betainc(dense * frames / 2, dense * np.maximum(lengths - frames, 1) / 2,
                       np.minimum(cost * frames / levels**2, 1.0))
        return np.exp(-np.sum(np.where(frames < lengths, less / frames, 0.0), axis=1))

    @cached_property
    def _stops(self) -> NDArray[np.float64]:
        """How often it does not pay to go on to the end of the batch, where leaving is free."""
        assert self._presence is not None
        beyond = np.arange(1, self._n_frames)[:, None]
        numbers, often = mixture(beyond, constant=False, signed=not self._model.non_negative)
        saved = (self._presence.per_frame - CHOICE) * beyond - self._presence.leaving
        # The rest sees nothing, which adds nothing.
        less = 1 + np.sum(often * (gammainc(numbers / 2, np.maximum(saved, 0.0) / 2) - 1),
                          axis=1)
        one = np.append(0.0, np.where(saved[:, 0] > 0, less, 0.0))
        beyond = self._n_frames - self.lengths
        both = np.convolve(one, one)[beyond] / np.maximum(beyond - 1, 1)
        return np.choose(self.ends, (np.ones_like(both), one[beyond], both))
