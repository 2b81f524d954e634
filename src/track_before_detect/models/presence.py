"""What it costs a path to be present, to enter and to leave."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel

# Log-likelihood that has to speak against a target before the end of its path is cut off.
CUT = 1.0
# Times that the frames of a target are told from its mean amplitude in the others.
MOST_ROUNDS = 5


@dataclass(frozen=True)
class Presence:
    """Price of the frames in which a target is there.

    The squared statistic always grows with the frames that are added up, so a path that may begin
    and end anywhere would never do so. With a cost for every frame it is in, noise no longer
    lengthens it. Costs raise the squared weight of a path, lambda_path^2 = lambda^2 + cost, which
    keeps the whole a group lasso with weights.

    The statistic of a constant amplitude is a mean and does not grow with the frames. It has no
    such cost, and those of entering and leaving are multiplied by its cost scale, as turns are.

    Attributes
    ----------
    per_frame : float
        Cost of a frame, in units of the value of a path. About what a frame adds to the largest
        value in noise.
    entry, leaving : float
        Cost of entering after the first frame of a batch and of leaving before its last.
    """

    per_frame: float
    entry: float
    leaving: float

    def cost(self, first: int, last: int, n_frames: int) -> float:
        """Return the cost of being present in the frames ``first`` to ``last``, both included."""
        return (self.per_frame * (last - first + 1) + self.entry * (first > 0)
                + self.leaving * (last < n_frames - 1))

    def best_interval(self, gains: NDArray) -> tuple[int, int]:
        """Return the first and last frame that gain most, for what each frame adds to a value."""
        return _best_run(np.asarray(gains, float) - self.per_frame, self.entry, self.leaving)

    def best_constant_interval(self, products: NDArray, squares: NDArray) -> tuple[int, int]:
        """Return the first and last frame with the largest statistic of a constant amplitude.

        Parameters
        ----------
        products, squares : array, shape (T,)
            n h and n^2 of each frame; a product of -inf where the target cannot be.
        """
        n_frames = len(products)
        first, last = np.triu_indices(n_frames)
        possible = np.isfinite(products)
        summed, square, impossible = (
            sums[last + 1] - sums[first] for sums in (
                np.append(0.0, np.cumsum(values)) for values in (
                    np.where(possible, products, 0.0), squares, ~possible)))
        costs = self.entry * (first > 0) + self.leaving * (last < n_frames - 1)
        values = (summed - np.sqrt(n_frames) * costs) / np.sqrt(np.maximum(square, 1e-30))
        best = int(np.argmax(np.where((square > 0) & (impossible == 0), values, -np.inf)))
        return int(first[best]), int(last[best])

    def whole_cost(self, n_frames: int) -> float:
        """Return the cost of being present in every frame of a batch."""
        return self.cost(0, n_frames - 1, n_frames)


def frames_seen_in(seen: NDArray, amplitude: float | None = None) -> tuple[int, int]:
    """Return the first and last frame in which a target was there, as far as can be told.

    Whether a path is worth its costs has to allow for all places and times at which noise may
    look like a target. Where a target that is there began and ended has not: a frame belongs to
    it when the mean amplitude of the others explains it better than none, by the likelihood
    s h - s^2 / 2 of an amplitude s.

    Parameters
    ----------
    seen : array, shape (T,)
        Statistic h of each frame along the path, magnitude where the sign is free.
    amplitude : float, optional
        Where it is known from other frames than these.
    """
    if amplitude is not None:
        return _best_run(amplitude * seen - 0.5 * amplitude**2, CUT, CUT)
    first, last = 0, len(seen) - 1
    for _ in range(MOST_ROUNDS):
        amplitude = max(float(np.mean(seen[first:last + 1])), 0.0)
        run = _best_run(amplitude * seen - 0.5 * amplitude**2, CUT, CUT)
        if run == (first, last):
            break
        first, last = run
    return first, last


def _best_run(gains: NDArray, entry: float, leaving: float) -> tuple[int, int]:
    """Return the ends of the run of largest sum, less the costs where it ends inside."""
    n_frames = len(gains)
    before = np.append(0.0, np.cumsum(gains))
    # A run begins where the sum before it, with what it may cost to enter, is least.
    starts = before[:-1] + entry * (np.arange(n_frames) > 0)
    ends = (before[1:] - leaving * (np.arange(n_frames) < n_frames - 1)
            - np.minimum.accumulate(starts))
    last = int(np.argmax(ends))
    return int(np.argmin(starts[:last + 1])), last


def presence_for(model: AmplitudeModel) -> Presence:
    """Return the costs for a model of the amplitudes, in units of its noise.

    Where amplitudes are constant the ends alone cost something.
    """
    return Presence(model.frame_cost, entry=model.end_cost, leaving=model.end_cost)
