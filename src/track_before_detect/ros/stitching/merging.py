"""One trajectory for each target that several regions of a stream see. No ROS types in here."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.tracking.stitcher import SAME_FRAME_GATE, Stitcher
from track_before_detect.types import Trajectory

# Share of the amplitudes in frames in which two sightings of one target are near each other.
SHARE_NEAR = 0.5
# Frames of which the numbers are kept, and the most of a batch; more than a few batches have.
KEPT_FRAMES = 2000


def check_sightings(found: Sequence[Trajectory]) -> None:
    """Raise DataError where what a region found cannot be trajectories of one batch."""
    for one in found:
        if not np.all(np.diff(one.stamps) > 0):
            raise DataError(f'the stamps of a trajectory must increase, found those of '
                            f'{one.id} to go from {one.stamps[0]:g} to {one.stamps[-1]:g} s in '
                            'another order')
    n_frames = len({stamp for one in found for stamp in one.stamps.tolist()})
    if n_frames > KEPT_FRAMES:
        raise DataError(f'a batch must have at most {KEPT_FRAMES} frames, got trajectories in '
                        f'{n_frames}')


class RegionStitcher:
    """Leaves out what was found twice, and keeps identities across seams and batches.

    Parameters
    ----------
    sigma_px : float
        Of the point spread function.
    """

    def __init__(self, sigma_px: float) -> None:
        self._gate = SAME_FRAME_GATE * max(sigma_px, 1.0)
        self._identities = Stitcher(sigma_px)
        self._interval_s = 1.0
        self._numbers: dict[float, int] = {}

    def reset(self) -> None:
        """Forget all identities: another stream begins; no id is used twice."""
        self._identities.reset()
        self._numbers = {}

    def merge(self, parts: Sequence[Sequence[Trajectory]]) -> list[Trajectory]:
        """Return the trajectories of one batch with ids of their own, by descending statistic.

        Parameters
        ----------
        parts : sequence of sequences of Trajectory
            What each region found, in pixels of the whole frames; frames are the same where their
            stamps are.
        """
        once = self._once(parts)
        self._count([one.stamps for one in once])
        return self._identities.link([
            replace(one, frame_indices=_increasing([self._numbers[stamp] for stamp in one.stamps]))
            for one in once])

    def _count(self, stamps: Sequence[NDArray[np.float64]]) -> None:
        """Give frames numbers that they keep, by their distance from the nearest known one."""
        steps = [np.diff(some) for some in stamps if len(some) > 1]
        if steps:
            self._interval_s = float(np.median(np.concatenate(steps)))
        for stamp in sorted({stamp for some in stamps for stamp in some} - self._numbers.keys()):
            nearest = min(self._numbers, key=lambda known: abs(known - stamp), default=stamp)
            n_frames = round((stamp - nearest) / self._interval_s)
            self._numbers[stamp] = (self._numbers.get(nearest, 0)
                                    + (n_frames or int(np.sign(stamp - nearest))))
        asked = {stamp for some in stamps for stamp in some}
        for stamp in sorted(self._numbers.keys() - asked)[:-KEPT_FRAMES]:
            del self._numbers[stamp]

    def _once(self, parts: Sequence[Sequence[Trajectory]]) -> list[Trajectory]:
        """Return the strongest of those that are one target, which a region finds once."""
        left = sorted(((one, region) for region, part in enumerate(parts) for one in part),
                      key=lambda pair: -pair[0].statistic)
        kept = []
        while left:
            strongest, own = left.pop(0)
            kept.append(strongest)
            for region in {region for _, region in left} - {own}:
                apart = [self._apart(strongest, one) if of == region else np.inf
                         for one, of in left]
                if min(apart) < np.inf:
                    del left[int(np.argmin(apart))]
        return kept

    def _apart(self, one: Trajectory, other: Trajectory) -> float:
        """Return the mean distance of two that are one target, infinity where they are two.

        A region that a target enters or leaves says nothing of where it is outside: they are one
        where they are within the gate in the frames that have most of the amplitudes.
        """
        _, in_one, in_other = np.intersect1d(one.stamps, other.stamps, return_indices=True)
        distances = np.hypot(*(one.positions[in_one] - other.positions[in_other]).T)
        # The amplitude of a frame without contrast is not a number.
        weights = np.nan_to_num(np.abs(one.amplitudes[in_one] * other.amplitudes[in_other]))
        if not weights.any():
            weights = np.ones_like(weights)
        near = distances <= self._gate
        if not near.any() or weights[near].sum() < SHARE_NEAR * weights.sum():
            return np.inf
        return float(np.average(distances[near], weights=weights[near]))


def _increasing(numbers: Sequence[int]) -> NDArray[np.int64]:
    """Return numbers that increase by one at least, where those of frames fell together."""
    rows = np.arange(len(numbers))
    return np.maximum.accumulate(np.array(numbers) - rows) + rows
