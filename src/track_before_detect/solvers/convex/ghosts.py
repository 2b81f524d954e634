"""One trajectory for a target that does not look as the PSF says.

A bright target that is wider than the PSF, or of another shape, leaves more beside the fit of one
path than noise does, and the pursuit explains the rest by further paths around it: ghosts. What
tells them from targets is that one target explains the frames as well as all of them, if it may
have a shape of its own that is the same in every frame (:mod:`extended_target`). Two
targets of the given PSF look like no such shape: at three widths of it apart some tenth of their
energy stays unexplained.

Two comparisons of the energy taken off the frames decide, each at a level of chi squared (half of
it, for energies are half squared norms) with as many degrees of freedom as the paths have more
than the one target:

- with the paths held to amplitudes in constant proportion, as ghosts have. Only the shape counts,
  so that the noise in many amplitudes does not hide it;
- with free amplitudes, for two targets may fluctuate apart from each other.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from track_before_detect.solvers.convex.extended_target import (
    ExtendedTarget,
    ExtendedTargetFitter,
    together,
)
from track_before_detect.solvers.fit.working_set import Source, WorkingSet
from track_before_detect.solvers.refine.target_model import TargetModel
from track_before_detect.solvers.watch import Watch

# Fewer frames tell too little about a shape.
LEAST_FRAMES = 8
# Ghosts stay this near to the path of their target, and move by so much beside it, in widths of
# the PSF.
REACH = 5.0
DRIFT = 6.0
# Level of chi squared of either comparison. With free amplitudes it is out of the reach of noise,
# because ghosts are where they follow the noise best. On a line a pair looks most like a wide
# target (docs/constants/convex.md).
CHANCE = 0.002
CHANCE_ON_A_LINE = 0.05
CHANCE_FREE = 1e-5
# Parameters of a motion, for each axis.
PER_AXIS = 2
# Times that the amplitudes around are fitted in turn.
SWEEPS = 4


class GhostSearch:
    """Finds paths that stand for one target together, and lets one stand for it, at t = 0.

    Parameters
    ----------
    targets : TargetModel
        What is known of the targets.
    paths : WorkingSet
        The solution.
    watch : Watch
        Says when the time is up: what is not looked at by then stays.
    """

    def __init__(self, targets: TargetModel, paths: WorkingSet, watch: Watch):
        self._fitter = ExtendedTargetFitter(targets)
        self._paths = paths
        self._watch = watch
        self._width = targets.measurement.width_px

    def merge(self) -> NDArray[np.float64]:
        """Leave one path for each target, with the amplitudes of t = 0.

        Returns
        -------
        array, shape (N,)
            Width in pixels of the targets that had ghosts: the standard deviation of the Gaussian
            that explains most.
        """
        paths = self._paths
        found: list[tuple[NDArray[np.int64], ExtendedTarget]] = []
        left = np.array([paths.n_present(path) >= LEAST_FRAMES for path in range(len(paths))],
                        bool)
        for path in np.argsort(-np.linalg.norm(paths.amplitudes, axis=1)):
            if self._watch.time_is_up():
                break
            if not left[path]:
                continue
            left[path] = False
            members, extended = self._target_at(path, left)
            if extended is not None:
                left[members] = False
                found.append((members, extended))
        if found:
            self._replace(found)
        return np.array([extended.width_px for _, extended in found])

    def _target_at(self, path: int, left: NDArray[np.bool_],
                   ) -> tuple[NDArray[np.int64], ExtendedTarget | None]:
        """Return paths that are one target, this one first, and that target; None without one."""
        paths = self._paths
        others = paths.neighbours(path)
        others = others[left[others]]
        offsets = [offset / self._width for offset in paths.offsets(path, others)]
        distances = [np.linalg.norm(offset, axis=1) for offset in offsets]
        near = np.array([
            distance.max() < REACH and np.linalg.norm(np.ptp(offset, axis=0)) < DRIFT
            for distance, offset in zip(distances, offsets, strict=True)], bool)
        if not near.any():
            return others, None
        members, extended = self._one_of(path, others[near])
        # Beside others, ghosts may be anywhere for some of the time.
        passing = np.array([distance.min() < REACH for distance in distances])
        if extended is None and np.any(passing & ~near):
            members, extended = self._one_of(path, others[passing])
        return members, extended

    def _one_of(self, path: int, others: NDArray[np.int64],
                ) -> tuple[NDArray[np.int64], ExtendedTarget | None]:
        """Return as :meth:`_target_at` does, of some of these others."""
        paths = self._paths
        while len(others) and not self._watch.time_is_up():
            members = np.append(path, others)
            with paths.without(*members) as frames:
                extended = self._fitter.fit(frames, paths.positions[path], paths.costs[path],
                                            paths.least_penalty)
                with paths.beside([extended.source]):
                    excess = np.array([paths.statistic(other, paths.residual_statistic(other))
                                       for other in others]) - paths.penalties[others]
            if excess.max() <= 0:
                return members, extended if self._explains(extended, members) else None
            # What the one target leaves there is worth a path.
            others = np.delete(others, np.argmax(excess))
        return others, None

    def _explains(self, extended: ExtendedTarget, members: NDArray[np.int64]) -> bool:
        """Return whether a target explains as much as the paths that it would stand for."""
        paths, model = self._paths, self._paths.model
        _, seen, envelope = together(*paths.joint_parts(members), model)
        in_proportion = 0.5 * model.statistic(seen, envelope)**2
        objective, _, _ = paths.fitted(members, 0.0)
        free = 0.5 * float(np.sum(paths.penalties[members]**2)) - objective
        n_axes = sum(side > 1 for side in paths.frames.shape[1:])
        n_others = len(members) - 1
        # Amplitudes that the paths have more than the target, which is there in frames of its own.
        n_present = int(np.count_nonzero(np.isfinite(extended.positions[:, 0])))
        n_amplitudes = (sum(model.n_numbers(paths.n_present(path)) for path in members)
                        - model.n_numbers(n_present))
        chance_of_shape = CHANCE if n_axes > 1 else CHANCE_ON_A_LINE
        return all(
            energy - extended.energy <= 0.5 * chdtri(
                max(numbers + n_others * PER_AXIS * n_axes - extended.n_shares, 1), chance)
            for energy, numbers, chance in (
                (in_proportion, n_others, chance_of_shape), (free, n_amplitudes, CHANCE_FREE)))

    def _replace(self, found: list[tuple[NDArray[np.int64], ExtendedTarget]]) -> None:
        """Let targets stand for their paths, and drop paths around them that are not needed."""
        paths = self._paths
        sources = [extended.source for _, extended in found]
        taken = np.concatenate([members for members, _ in found])
        around = np.unique(np.concatenate([paths.neighbours(path) for path in taken]))
        around = np.setdiff1d(around, taken)
        paths.assign(taken, np.zeros_like(paths.amplitudes[taken]))
        with paths.beside(sources):
            dropped = [self._not_needed(around, sources)]
        for number, (members, extended) in enumerate(found):
            with paths.beside(sources[:number] + sources[number + 1:]):
                self._move(members[0], extended)
            dropped.append(members[1:])
        for members, _ in found:
            self._set(members[0], paths.best(members[0]))
        paths.remove(np.concatenate(dropped))

    def _move(self, path: int, extended: ExtendedTarget) -> None:
        """Put a path without amplitudes where its target is seen best."""
        paths = self._paths
        own = (paths.statistic(path, paths.residual_statistic(path)), paths.positions[path],
               paths.costs[path])
        paths.move(path, extended.positions, extended.cost)
        # The middle of a target is not that of a PSF whose energy lies beside its own middle.
        if paths.statistic(path, paths.residual_statistic(path)) < own[0]:
            paths.move(path, own[1], own[2])

    def _not_needed(self, around: NDArray[np.int64], sources: list[Source],
                    ) -> NDArray[np.int64]:
        """Drop from the fit the paths that do not pass their penalty on what all others leave.

        A ghost may have gone from one target to the next.
        """
        paths = self._paths
        dropped = []
        kept = around[np.argsort(-np.linalg.norm(paths.amplitudes[around], axis=1))]
        for path in kept[::-1]:
            if self._watch.time_is_up():
                break
            self._set(path, np.zeros_like(paths.amplitudes[path]))
            others = kept[kept != path]
            for _ in range(SWEEPS):
                for source in sources:
                    paths.fit_source(source)
                for other in others:
                    seen = paths.amplitudes[other] + paths.residual_statistic(other)
                    self._set(other, paths.best(other, seen))
            seen = paths.residual_statistic(path)
            if paths.statistic(path, seen) > paths.penalties[path]:
                self._set(path, paths.best(path, seen))
            else:
                dropped.append(path)
                kept = others
        return np.array(dropped, np.int64)

    def _set(self, path: int, amplitudes: NDArray) -> None:
        self._paths.assign(np.array([path]), amplitudes[None])
