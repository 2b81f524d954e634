"""The trajectories of successive batches as one for each identity."""

from dataclasses import dataclass, replace

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
    """Trajectories over batches, each frame from the batch that holds it deepest inside.

    A target that is followed through the whole of a batch may have entered or left during it. What
    tells is the batch before, or after, which shares frames with that one and has not found it: it
    is then reported from where, or up to where, its amplitude says that it is there.

    Parameters
    ----------
    stamps : array, shape (T,)
        Of all frames, in seconds.
    width_px : float
        Of the point spread function: two targets that are nearer in most frames of one of them
        cannot be told apart, and the one with the smaller statistic is left out.
    """

    def __init__(self, stamps: NDArray[np.float64], width_px: float):
        self._stamps = stamps
        self._width_px = max(width_px, 1.0)
        self._parts: dict[int, list[_Part]] = {}
        self._batches: list[NDArray[np.int64]] = []

    def add(self, frame_indices: NDArray[np.int64], trajectories: list[Trajectory]) -> None:
        """Add what was found in a batch of frames, the batches in their order."""
        for trajectory in trajectories:
            self._parts.setdefault(trajectory.id, []).append(
                _Part(len(self._batches), trajectory))
        self._batches.append(frame_indices)

    def trajectories(self, over_all_frames: bool = True) -> list[Trajectory]:
        """Return one trajectory for each identity, NaN where it is absent, the best first.

        Their rows are for all frames, or from the first to the last frame of the batches that
        found it: all frames of many trajectories take memory that grows with the square of the
        length of a recording.
        """
        joined = sorted((self._join(parts) for parts in self._parts.values()),
                        key=lambda trajectory: -trajectory.statistic)
        first, last = np.array([one.frame_indices[[0, -1]] for one in joined],
                               np.int64).reshape(-1, 2).T
        is_kept = np.zeros(len(joined), bool)
        for number, one in enumerate(joined):
            # Few share frames with it in a long recording.
            beside = is_kept & (first <= last[number]) & (first[number] <= last)
            is_kept[number] = not any(self._is_part_of(one, joined[better])
                                      for better in np.flatnonzero(beside))
        kept = [joined[number] for number in np.flatnonzero(is_kept)]
        if not over_all_frames:
            return kept
        all_frames = np.arange(len(self._stamps))
        return [self._over(all_frames, one) for one in kept]

    def _is_part_of(self, one: Trajectory, other: Trajectory) -> bool:
        """Return whether a trajectory is with another one in most of its frames."""
        starts = [trajectory.frame_indices[0] for trajectory in (one, other)]
        ends = [1 + trajectory.frame_indices[-1] for trajectory in (one, other)]
        here, there = (trajectory.positions[max(starts) - start:min(ends) - start]
                       for trajectory, start in zip((one, other), starts, strict=True))
        distance = np.hypot(*(here - there).T)
        n_near = np.count_nonzero(distance < self._width_px)
        return bool(n_near > 0.5 * np.count_nonzero(np.isfinite(one.positions[:, 0])))

    def _over(self, all_frames: NDArray[np.int64], one: Trajectory) -> Trajectory:
        """Return a trajectory with rows for all frames."""
        def spread(values: NDArray) -> NDArray:
            rows = np.full((len(all_frames), *values.shape[1:]), np.nan, values.dtype)
            rows[one.frame_indices] = values
            return rows

        return replace(one, positions=spread(one.positions), amplitudes=spread(one.amplitudes),
                       velocity=spread(one.velocity), covariance=spread(one.covariance),
                       stamps=self._stamps, frame_indices=all_frames)

    def _join(self, parts: list[_Part]) -> Trajectory:
        """Return a trajectory with rows from the first to the last frame of its parts."""
        start = min(part.trajectory.frame_indices.min() for part in parts)
        end = 1 + max(part.trajectory.frame_indices.max() for part in parts)
        n_frames = end - start
        depth = np.full(n_frames, -1)
        positions = np.full((n_frames, 2), np.nan)
        velocity = np.full((n_frames, 2), np.nan)
        covariance = np.full((n_frames, 2, 2), np.nan)
        trajectories = [part.trajectory for part in parts]
        # Complex where those of a part are.
        amplitudes = np.full(n_frames, np.nan,
                             np.result_type(*[one.amplitudes for one in trajectories]))
        there = [np.ones(len(one.frame_indices), bool) for one in trajectories]
        last = len(parts) - 1
        for at, beside, towards in ((0, min(1, last), -1), (last, max(last - 1, 0), 1)):
            there[at] &= self._there(parts[at], trajectories[beside], towards)
        for one, seen in zip(trajectories, there, strict=True):
            own = np.arange(len(one.frame_indices))
            inside = np.minimum(own, own[::-1])
            better = inside > depth[one.frame_indices - start]
            rows = one.frame_indices[better] - start
            depth[rows] = inside[better]
            positions[rows] = np.where(seen[:, None], one.positions, np.nan)[better]
            velocity[rows] = np.where(seen[:, None], one.velocity, np.nan)[better]
            amplitudes[rows] = np.where(seen, one.amplitudes, np.nan)[better]
            covariance[rows] = np.where(seen[:, None, None], one.covariance, np.nan)[better]
        best = max(trajectories, key=lambda part: part.statistic)
        return Trajectory(best.id, positions, amplitudes, velocity, self._stamps[start:end],
                          np.arange(start, end), best.statistic,
                          float(np.mean([part.snr for part in trajectories])),
                          covariance=covariance)

    def _there(self, part: _Part, beside: Trajectory, towards: int) -> NDArray[np.bool_]:
        """Return in which frames of a part its target may be, for one end of a trajectory.

        ``part`` is the first (``towards`` -1) or last one (1) of it, ``beside`` that next to it
        if there is one: the mean amplitude of a target that enters or leaves is best seen there.
        """
        one, number = part.trajectory, part.batch + towards
        there = np.ones(len(one.frame_indices), bool)
        present = np.flatnonzero(np.isfinite(one.positions[:, 0]))
        size = np.nan_to_num(np.abs(one.amplitudes[present]))
        overlaps = (0 <= number < len(self._batches)
                    and np.isin(one.frame_indices, self._batches[number]).any())
        if overlaps and size.any():
            # In units of the noise, as the mean over the frames is known to be.
            seen = size * one.snr / size.mean()
            first, last = frames_seen_in(seen, max(_brightest_mean(seen), beside.snr))
            if towards < 0:
                there[:present[first]] = False
            else:
                there[present[last] + 1:] = False
        return there


def _brightest_mean(seen: NDArray[np.float64]) -> float:
    """Return the mean amplitude of the run of frames that a constant one explains best."""
    first, last = np.triu_indices(len(seen))
    before = np.append(0.0, np.cumsum(seen))
    sums, lengths = before[last + 1] - before[first], last + 1 - first
    best = np.argmax(sums / np.sqrt(lengths))
    return float(sums[best] / lengths[best])
