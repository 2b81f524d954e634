"""Give trajectories of successive batches the identity they had before."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from track_before_detect.types import Trajectory

# Pixels between two sightings of one target in the same frame, in units of the PSF's sigma.
SAME_FRAME_GATE = 3.0


@dataclass
class _Known:
    """Newest sighting of an identity."""

    trajectory: Trajectory
    batches_ago: int = 0


def not_carried(candidates: Iterable[Trajectory],
                trajectories: Iterable[Trajectory]) -> list[Trajectory]:
    """Return the candidates that carry on none of the trajectories: their positions stay."""
    carried = {id(one.positions) for one in trajectories}
    return [one for one in candidates if id(one.positions) not in carried]


class Stitcher:
    """Keeps identities over overlapping or adjoining batches.

    Two trajectories are one target when their mean distance over the frames both saw is within
    the gate; each frame counts by the amplitudes there, for where a target is not yet, or no
    longer, its path says nothing of it. Where they saw no frame in common the older one is carried
    on at its last velocity, with a gate that grows by one sigma of the PSF for each frame between.

    Parameters
    ----------
    sigma_px : float
        Of the point spread function.
    memory : int
        Batches that an identity is remembered for without being seen.
    """

    def __init__(self, sigma_px: float, memory: int = 2):
        self._gate = SAME_FRAME_GATE * max(sigma_px, 1.0)
        self._slack = max(sigma_px, 1.0)
        self._memory = memory
        self._known: list[_Known] = []
        self._next_id = 1

    def reset(self) -> None:
        """Forget all identities; numbering goes on, so that no id is used twice."""
        self._known = []

    def link(self, trajectories: list[Trajectory], period_px: float | None = None,
             weaker: Sequence[Trajectory] = ()) -> list[Trajectory]:
        """Return the trajectories of one batch with their ids set.

        Parameters
        ----------
        trajectories : list of Trajectory
        weaker : sequence of Trajectory, optional
            Candidates that are targets where they carry on an identity of the batch before which
            no trajectory does.
        period_px : float, optional
            Columns after which the frames begin again, where they go round.
        """
        excess = self._distances_over_gate(
            [known.trajectory for known in self._known], trajectories, period_px)
        cost = np.minimum(excess, 2.0)
        ids: dict[int, int] = {}
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if excess[i, j] <= 1.0:
                ids[int(j)] = self._known[i].trajectory.id
        named = []
        for j, trajectory in enumerate(trajectories):
            if j not in ids:
                ids[j] = self._next_id
                self._next_id += 1
            named.append(replace(trajectory, id=ids[j]))
        named += self.carried_on(
            [known.trajectory for known in self._known
             if known.trajectory.id not in ids.values() and not known.batches_ago],
            weaker, period_px)
        seen = {trajectory.id for trajectory in named}
        self._known = [_Known(trajectory) for trajectory in named] + [
            _Known(known.trajectory, known.batches_ago + 1) for known in self._known
            if known.trajectory.id not in seen and known.batches_ago + 1 < self._memory]
        return named

    def carried_on(self, known: Sequence[Trajectory], weaker: Sequence[Trajectory],
                   period_px: float | None = None) -> list[Trajectory]:
        """Return the candidates that carry on trajectories, with their ids, each at most once.

        Parameters
        ----------
        known : sequence of Trajectory
            In a batch that shares frames with that of the candidates.
        weaker : sequence of Trajectory
            Candidates.
        period_px : float, optional
            As of :meth:`link`.
        """
        carried, left = [], np.ones(len(weaker), bool)
        for trajectory, excess in zip(known, self._distances_over_gate(known, weaker, period_px),
                                      strict=True):
            near = np.flatnonzero(left & (excess <= 1.0)).tolist()
            if near:
                best = max(near, key=lambda number: weaker[number].statistic)
                left[best] = False
                carried.append(replace(weaker[best], id=trajectory.id, reason=''))
        return carried

    def _distances_over_gate(self, older: Sequence[Trajectory], newer: Sequence[Trajectory],
                             period: float | None) -> NDArray[np.float64]:
        """Return how far each of the older is from each of the newer, in units of the gate."""
        excess = np.full((len(older), len(newer)), np.inf)
        for group in _of_same_frames(newer):
            for row, trajectory in zip(excess, older, strict=True):
                row[group.numbers] = self._distances_of_group(trajectory, group, period)
        return excess

    def _distances_of_group(self, older: Trajectory, newer: '_Group',
                            period: float | None) -> NDArray[np.float64]:
        _, in_older, in_newer = np.intersect1d(
            older.frame_indices, newer.frame_indices, assume_unique=True, return_indices=True)
        distance = _distances(older.positions[in_older], newer.positions[:, in_newer], period)
        known = np.isfinite(distance)
        weights = known * np.nan_to_num(np.abs(
            older.amplitudes[in_older] * newer.amplitudes[:, in_newer]))
        weights = np.where(weights.any(axis=1, keepdims=True), weights, known)
        both, there = known.any(axis=1), np.isfinite(newer.positions[..., 0])
        excess = np.full(len(both), np.inf)
        excess[both] = (np.sum(weights * np.where(known, distance, 0.0), axis=1)[both]
                        / weights.sum(axis=1)[both] / self._gate)
        present = np.flatnonzero(np.isfinite(older.positions[:, 0]))
        others = np.flatnonzero(~both & there.any(axis=1))
        if len(present) and len(others):
            last, first = present[-1], there[others].argmax(axis=1)
            elapsed = newer.stamps[others, first] - older.stamps[last]
            frames = np.maximum(1, newer.frame_indices[first] - older.frame_indices[last])
            expected = older.positions[last] + older.velocity[last] * elapsed[:, None]
            excess[others] = (_distances(expected, newer.positions[others, first], period)
                              / (self._gate + self._slack * frames))
        return excess


class _Group(NamedTuple):
    """Trajectories of the same frames: which they are, their frames (T,), the rest (N, T, ...)."""

    numbers: list[int]
    frame_indices: NDArray
    stamps: NDArray
    positions: NDArray
    amplitudes: NDArray


def _of_same_frames(trajectories: Sequence[Trajectory]) -> Iterator[_Group]:
    numbers: dict[bytes, list[int]] = {}
    for number, trajectory in enumerate(trajectories):
        numbers.setdefault(trajectory.frame_indices.tobytes(), []).append(number)
    for same in numbers.values():
        of = [trajectories[number] for number in same]
        yield _Group(same, of[0].frame_indices, *(
            np.stack(values) for values in zip(*(
                (one.stamps, one.positions, one.amplitudes) for one in of), strict=True)))


def _distances(a: NDArray, b: NDArray, period: float | None) -> NDArray:
    across = a[..., 0] - b[..., 0]
    if period is not None:
        across = (across + 0.5 * period) % period - 0.5 * period
    return np.hypot(across, a[..., 1] - b[..., 1])
