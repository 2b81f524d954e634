"""The trajectories of successive batches as one for each identity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.presence import frames_seen_in
from track_before_detect.types import Trajectory


@dataclass(frozen=True)
class _Part:
    """What one batch knows of an identity."""

    batch: int
    trajectory: Trajectory


class JoinedTrajectories:
    """Trajectories over all frames, each frame from the batch that holds it deepest inside.

    A target that is followed through the whole of a batch may have entered or left during it. What
    tells is the batch before, or after, which shares frames with that one and has not found it: in
    these frames it is reported from where its amplitude says that it is there.

    Parameters
    ----------
    stamps : array, shape (T,)
        Of all frames, in seconds.
    """

    def __init__(self, stamps: NDArray[np.float64]):
        self._stamps = stamps
        self._parts: dict[int, list[_Part]] = {}
        self._batches: list[NDArray[np.int64]] = []

    def add(self, frame_indices: NDArray[np.int64], trajectories: list[Trajectory]) -> None:
        """Add what was found in a batch of frames, the batches in their order."""
        for trajectory in trajectories:
            self._parts.setdefault(trajectory.id, []).append(
                _Part(len(self._batches), trajectory))
        self._batches.append(frame_indices)

    def trajectories(self) -> list[Trajectory]:
        """Return one trajectory for each identity, NaN where it is absent, the best first."""
        joined = [self._join(parts) for parts in self._parts.values()]
        return sorted(joined, key=lambda trajectory: -trajectory.statistic)

    def _join(self, parts: list[_Part]) -> Trajectory:
        n_frames = len(self._stamps)
        depth = np.full(n_frames, -1)
        positions = np.full((n_frames, 2), np.nan)
        velocity = np.full((n_frames, 2), np.nan)
        trajectories = [part.trajectory for part in parts]
        # Complex where those of a part are.
        amplitudes = np.full(n_frames, np.nan,
                             np.result_type(*[one.amplitudes for one in trajectories]))
        for part in trajectories:
            own = np.arange(len(part.frame_indices))
            inside = np.minimum(own, own[::-1])
            better = inside > depth[part.frame_indices]
            rows = part.frame_indices[better]
            depth[rows] = inside[better]
            positions[rows] = part.positions[better]
            velocity[rows] = part.velocity[better]
            amplitudes[rows] = part.amplitudes[better]
        absent = np.concatenate([self._absent(parts[0], -1), self._absent(parts[-1], 1)])
        positions[absent], velocity[absent], amplitudes[absent] = np.nan, np.nan, np.nan
        best = max(trajectories, key=lambda part: part.statistic)
        return Trajectory(best.id, positions, amplitudes, velocity, self._stamps,
                          np.arange(n_frames), best.statistic,
                          float(np.mean([part.snr for part in trajectories])))

    def _absent(self, part: _Part, towards: int) -> NDArray[np.int64]:
        """Return the frames at one end of a trajectory in which its target is not there yet.

        ``part`` is the first (``towards`` -1) or last one (1) of it.
        """
        number = part.batch + towards
        if not 0 <= number < len(self._batches):
            return np.empty(0, np.int64)
        one = part.trajectory
        present = np.flatnonzero(np.isfinite(one.positions[:, 0]))
        size = np.nan_to_num(np.abs(one.amplitudes[present]))
        if not size.any():
            return np.empty(0, np.int64)
        first, last = frames_seen_in(size * one.snr / size.mean())
        beyond = present[:first] if towards < 0 else present[last + 1:]
        return np.intersect1d(one.frame_indices[beyond], self._batches[number])
