"""Subspace pursuit with continuation: the convex detector (Patent, Algorithms 3-5).

One objective serves the whole continuation, t from 1 (convex) to 0 (combinatorial):

    F_t = 1/2 |y - A x|^2 + t sum_p w_p |x_p| + 1/2 (1 - t)^2 sum of w_p^2 over used paths,

with w_p^2 = threshold^2 + cost of the turns of path p (or as the amplitude model has it). A lone
path with statistic eta lowers F_t by 1/2 (eta - t w)^2 and costs 1/2 (1 - t)^2 w^2, so it is worth
adding exactly when eta > w, whatever t: one threshold serves the schedule. Every change (adding,
moving, merging, removing a path) is accepted only when F_t falls, which is what makes each stage
end; Algorithm 5 taken literally can swap paths for ever.

All paths are searched in the first and in the last stage, and wherever t = 1. The stages between
only merge, move and remove what is there: their amplitudes are shrunk less than before, so the
residual shows less than in the stage before, and the last stage has the final word.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from track_before_detect.solvers.convex.certificate import duality_gap
from track_before_detect.solvers.fit.working_set import FIT_GAP, WorkingSet
from track_before_detect.solvers.refine.refinement import PathRefiner
from track_before_detect.solvers.search.path_search import FoundPath, PathSearch
from track_before_detect.solvers.watch import Watch
from track_before_detect.types import Step

StepT = TypeVar('StepT')

# Paths added before the residual is searched again; each is tested on the residual it meets.
MOST_NEW_PATHS = 256
# No scene that can be told apart holds more; frames whose noise is far above one would.
MOST_PATHS = 500
# Work of all fits of a batch, as a WorkingSet counts it, after which nothing more is fitted: where
# the noise is far above one there is no end of overlapping paths (docs/constants/convex.md).
MOST_WORK = 2e8
# Two paths that share this much of their energy in the mean frame may be one target.
ALIKE = 0.3
# Passes over all paths in one round, and the fall of F_t that makes another one worthwhile; adding
# a path gains some tens.
MOST_PASSES = 5
WORTHWHILE = 0.5
# A change has to lower F_t by more than the rounding of the sums and of the amplitudes.
LEAST_GAIN = 1e-3
# Merging two paths of one frame has to lower F_0 by more. The price of a path allows for all the
# places noise may look like a target at; one path beside another has but a few. Each further frame
# gives two paths one more amplitude to follow the noise with, and half a unit of F_0, which is
# taken off (docs/constants/convex.md).
MERGING_GAIN = 3.75
NOISE_PER_FRAME = 0.5
# Rounds in which a convex solution that is the result may move its paths off the grid. After them
# its columns are fixed, the paths of the grid and those it holds, and adding those that violate
# their bound has an end.
MOVING_ROUNDS = 3
# Share of the separation of new paths at which they are added then, for neighbours are wanted.
SIDE_BY_SIDE = 0.3
# Most overlapping paths that are fitted together when the time is up.
QUICKLY_FITTED = 30
# Duality gap of the amplitudes of a convex solution that is the result.
CERTIFIED_GAP = 1e-9
# The same for a stage before the last, as a share of what a path has to gain: it only starts the
# next, and among many bright neighbours the last digits take most of the time.
STAGE_GAP = 1e-3


@dataclass(frozen=True)
class PursuitSettings:
    """How long and how exactly to solve.

    Attributes
    ----------
    continuation : sequence of float
        Values of t, in the order they are visited.
    tolerance : float
        Largest relative excess of any path over the threshold at the end of the last stage.
    stage_tolerance : float
        The same for the stages before the last, whose solution only starts the next.
    most_rounds : int
        Rounds of search and fit in one stage before it is called unconverged.
    """

    continuation: Sequence[float]
    tolerance: float = 1e-6
    stage_tolerance: float = 0.05
    most_rounds: int = 50


@dataclass(frozen=True)
class PursuitResult:
    """Solution of the pursuit.

    Attributes
    ----------
    paths : WorkingSet
        Paths, amplitudes, residual.
    status : str
        ``"converged"``, ``"iteration_limit"`` or ``"time_limit"``.
    history : list of Step
        One entry for each round.
    gap : float
        Duality gap at the end of the stage t = 1, NaN without one.
    best : float
        Largest value of any path of the grid on the residual that was searched last, NaN where
        the search only found that it is below what it looked for.
    """

    paths: WorkingSet
    status: str
    history: list[Step]
    gap: float
    best: float


def pursue(search: PathSearch, refiner: PathRefiner, paths: WorkingSet, separation: float,
           settings: PursuitSettings, start: Sequence[FoundPath] = (),
           watch: Watch | None = None) -> PursuitResult:
    """Find all paths jointly, or as many as there is time for.

    Parameters
    ----------
    search : PathSearch
        Finds the best path on a residual.
    refiner : PathRefiner
        Moves a path off the grid.
    paths : WorkingSet
        Starts empty.
    separation : float
        Pixels; new paths of one search end at least this far apart.
    settings : PursuitSettings
        Schedule and tolerances.
    start : sequence of FoundPath
        Paths that are tried before the first search, in this order.
    watch : Watch, optional
        Says when the time is up; it never is unless given.
    """
    watch = watch or Watch()
    history: list[Step] = []
    status = 'converged'
    gap = best = float('nan')
    for number, t_convex in enumerate(settings.continuation):
        last = number == len(settings.continuation) - 1
        tolerance = settings.tolerance if last else settings.stage_tolerance
        watch.begin_stage(number, len(settings.continuation))
        stage = _Stage(search, refiner, paths, separation, t_convex, last, watch)
        if number == 0:
            stage.begin(start)
        if number == 0 or last or t_convex == 1.0:
            largest, finished = stage.run(tolerance, settings.most_rounds, history)
            best = stage.best
        else:
            finished = stage.polish(history)
        if not finished:
            status = 'iteration_limit'
        if watch.stopped:
            break
        if t_convex == 1.0:
            gap = duality_gap(paths, largest)
    if watch.stopped and settings.continuation[-1] < 1.0:
        keep_what_passes(paths)
        history.append(state_of(paths, 0.0))
    return PursuitResult(paths, watch.status(status), history, gap, best)


def keep_what_passes(paths: WorkingSet) -> None:
    """Leave the paths that pass their penalties beside each other, with the amplitudes of t = 0.

    What is at hand when the time is up may be shrunk, and several paths for one target. The
    strongest are taken first, as the plain greedy method does, then the weakest that do not pass
    beside the others are left out until each does: without a search and without a fit of many
    paths, in a time that is bounded by their number.
    """
    order = np.argsort(-np.linalg.norm(paths.amplitudes, axis=1))
    paths.assign(order, np.zeros_like(paths.amplitudes))
    for path in order:
        if paths.statistic(path) > paths.penalties[path]:
            paths.assign(np.array([path]), paths.best(path)[None])
    while True:
        paths.remove(np.flatnonzero(~np.any(paths.amplitudes, axis=1)))
        for members in paths.clusters():
            if len(members) <= QUICKLY_FITTED:
                paths.assign(members, paths.fitted(members, 0.0)[1])
        n_kept = len(paths)
        for path in np.argsort(np.linalg.norm(paths.amplitudes, axis=1)):
            if paths.statistic(path) <= paths.penalties[path]:
                paths.assign(np.array([path]), np.zeros_like(paths.amplitudes[[path]]))
                n_kept -= 1
        if n_kept == len(paths):
            break
    paths.refresh()


def state_of(paths: WorkingSet, t_convex: float, violation: float = float('nan')) -> Step:
    """Return the present state as a step of the history, the violation where it is known."""
    return Step(t_convex, paths.objective(t_convex), len(paths), violation)


def _far_apart(separation: float, positions: NDArray) -> Iterator[int]:
    """Yield the numbers of paths (N, T, 2) that are not near an earlier one of these.

    Near in more than a quarter of the frames: such a path would hardly pass beside the earlier.
    """
    left = np.arange(len(positions))
    while len(left):
        number, left = left[0], left[1:]
        yield number
        distance = np.hypot(*(positions[left] - positions[number]).transpose(2, 0, 1))
        near = np.count_nonzero(distance < separation, axis=1)
        left = left[near <= 0.25 * np.count_nonzero(np.isfinite(distance), axis=1)]


class _Stage:
    """The pursuit at one value of t."""

    def __init__(self, search: PathSearch, refiner: PathRefiner, paths: WorkingSet,
                 separation: float, t_convex: float, last: bool, watch: Watch):
        self._search = search
        self._refiner = refiner
        self._paths = paths
        self._separation = separation
        self._t = t_convex
        # Only a convex solution that is the last is wanted to more digits, for its certificate.
        # Moving the many neighbours of a bright target until they settle would be wasted before
        # the last stage: most vanish in the next.
        self._certified = last and t_convex == 1.0
        if self._certified:
            self._fit_gap = CERTIFIED_GAP
        else:
            self._fit_gap = FIT_GAP if last else STAGE_GAP * paths.least_penalty**2
        self._last = last
        self._watch = watch
        self._most_passes = MOST_PASSES if last and t_convex < 1 else 1
        self._cut_short = False
        self.best = float('nan')
        # Ids of the paths that took the place of others, and moved for it, in this pass.
        self._merged_into: set[int] = set()

    def begin(self, start: Iterable[FoundPath]) -> None:
        """Add the paths to start with that are worth it."""
        for path in self._while_affordable(start):
            self._try_adding(path)

    def run(self, tolerance: float, most_rounds: int, history: list[Step],
            ) -> tuple[float, bool]:
        """Alternate between improving the paths at hand and searching for new ones.

        Returns
        -------
        largest : float
            Largest value of any path on the residual, or a bound of it; ``best`` is NaN then.
        finished : bool
            Whether the stage reached its end.
        """
        paths = self._paths
        bound = paths.model.value(paths.least_penalty * (1 + tolerance))
        # The last word is with the refined paths, and their threshold: what is on the grid of a
        # dim target may be below it.
        level = bound
        if self._last and not self._certified:
            level = min(bound, paths.model.grid_level(paths.least_penalty))
        largest = 0.0
        for number in range(most_rounds):
            frozen = self._certified and number >= MOVING_ROUNDS
            fitted = self._fit_all() if frozen else self._improve()
            paths.refresh()
            if self._watch.time_is_up():
                return largest, False
            separation = SIDE_BY_SIDE * self._separation if frozen else self._separation
            largest, found = self._search.best_paths(
                paths.residual, level, separation, MOST_NEW_PATHS,
                partial(_far_apart, separation))
            self.best = float('nan') if largest == level else largest
            violation = paths.model.from_value(largest) / paths.least_penalty - 1
            history.append(state_of(paths, self._t, violation))
            self._watch.end_round()
            if not found:
                return largest, fitted and largest <= bound
            if len(paths) >= MOST_PATHS:
                return largest, False
            added = sum([self._add_violating(path, tolerance) if frozen else self._try_adding(path)
                         for path in self._while_affordable(found)])
            if added:
                continue
            if self._cut_short:
                return largest, False
            if frozen:
                # What the search saw is the rounding of its single precision.
                return bound, fitted
            if not self._certified:
                # The best path does not lower F_t once the others are fitted with it.
                return largest, self._t < 1
        # The last round may have added paths.
        history.append(state_of(paths, self._t))
        return largest, False

    def polish(self, history: list[Step]) -> bool:
        """Improve the paths at hand: shrinking less, they leave less for others to find."""
        fitted = self._improve()
        self._paths.refresh()
        history.append(state_of(self._paths, self._t))
        return fitted

    def _while_affordable(self, steps: Iterable[StepT]) -> Iterator[StepT]:
        """Yield what is to be fitted next until the fits of the batch have taken enough, or time.

        Every loop that fits goes through here, so that a stage which has to end runs out of steps.
        """
        for step in steps:
            if self._paths.work > MOST_WORK or self._watch.time_is_up():
                self._cut_short = True
                return
            yield step

    def _try_adding(self, found: FoundPath) -> bool:
        """Add a path if it still passes its penalty and F_t falls."""
        paths = self._paths
        if not paths.may_pass(found.positions, found.cost):
            return False
        added = paths.add(found.positions, found.cost)
        self._refine(added)
        if paths.statistic(added) <= paths.penalties[added]:
            paths.remove(np.array([added]))
            return False
        members = paths.neighbours(added)
        before = paths.objective_of(members, self._t)
        after, amplitudes, _ = self._fitted(members)
        if after < before - LEAST_GAIN:
            paths.assign(members, amplitudes)
            return True
        paths.remove(np.array([added]))
        return False

    def _add_violating(self, found: FoundPath, tolerance: float) -> bool:
        """Add a path of the grid as it is when it passes its penalty, the amplitudes fixed."""
        paths = self._paths
        added = paths.add(found.positions, found.cost)
        if paths.statistic(added) > (1 + tolerance) * paths.penalties[added]:
            return True
        paths.remove(np.array([added]))
        return False

    def _fit_all(self) -> bool:
        """Fit all amplitudes; return whether that converged."""
        fitted = True
        for members in self._while_affordable(self._paths.clusters()):
            fitted = self._fit(members) and fitted
        self._drop_empty()
        return fitted and not self._cut_short

    def _improve(self) -> bool:
        """Fit, refine, merge and remove paths while F_t falls; return whether fits converged."""
        paths = self._paths
        fitted = self._fit_all()
        for _ in range(self._most_passes):
            before = paths.objective(self._t)
            order = np.argsort(np.linalg.norm(paths.amplitudes, axis=1))
            self._merged_into.clear()
            # Removing a path renumbers the rest, their ids stay.
            for path_id in self._while_affordable([paths.ids[p] for p in order]):
                if path_id not in paths.ids or path_id in self._merged_into:
                    continue
                path = paths.ids.index(path_id)
                if not self._remove_if_better(path) and self._refine(path):
                    # A stage before the last fits its neighbours once, when all have moved.
                    self._fit(paths.neighbours(path) if self._last else np.array([path]))
            self._drop_empty()
            if not self._last:
                fitted = self._fit_all()
            if before - paths.objective(self._t) < WORTHWHILE:
                break
        if self._t < 1:
            self._prune()
        return fitted and not self._cut_short

    def _prune(self) -> None:
        """Remove paths that no longer pass their penalty beside all others, the weakest first.

        With the others as they are, F_t falls by 1/2 (1 - t)^2 w^2 - 1/2 (eta - t w)^2, which is
        positive exactly when the statistic eta is below the penalty w.
        """
        paths = self._paths
        # Each step removes a path, or nothing is left to remove.
        for _ in self._while_affordable(range(len(paths))):
            excess = np.array([paths.statistic(path)
                               for path in range(len(paths))]) - paths.penalties
            weakest = int(np.argmin(excess))
            if excess[weakest] >= 0:
                return
            others = paths.neighbours(weakest)
            others = others[others != weakest]
            paths.remove(np.array([weakest]))
            if len(others):
                self._fit(others - (others > weakest))

    def _fitted(self, members: NDArray) -> tuple[float, NDArray, bool]:
        """Return as :meth:`WorkingSet.fitted` does, at this stage."""
        return self._paths.fitted(members, self._t, self._fit_gap, self._watch)

    def _fit(self, members: NDArray) -> bool:
        """Fit some amplitudes, all others fixed; return whether that converged."""
        _, amplitudes, converged = self._fitted(members)
        self._paths.assign(members, amplitudes)
        return converged

    def _drop_empty(self) -> None:
        empty = np.flatnonzero(~np.any(self._paths.amplitudes, axis=1))
        if len(empty):
            self._paths.remove(empty)

    def _refine(self, path: int) -> bool:
        """Move one path, the others fixed; True when it moved."""
        paths = self._paths
        # The best place for a path that overlaps no other depends on neither t nor the others.
        alone = len(self._paths.neighbours(path)) == 1
        if alone and paths.settled[path]:
            return False
        with paths.without(path) as frames:
            better = self._refiner.refine(
                frames, paths.positions[path], paths.costs[path], paths.least_penalty, self._t)
        if better is None:
            paths.settled[path] = alone
            return False
        paths.move(path, *better)
        return True

    def _remove_if_better(self, path: int) -> bool:
        """Remove a path, or merge it into its nearest neighbour, when that lowers F_t."""
        paths = self._paths
        members = paths.neighbours(path)
        # A path that overlaps no other pays while it passes its penalty, which pruning asks.
        if self._t == 1.0 or len(members) == 1:
            return False
        before = paths.objective_of(members, self._t)
        others = members[members != path]
        after, amplitudes, _ = self._fitted(others)
        if after < before - LEAST_GAIN:
            paths.assign(others, amplitudes)
            paths.remove(np.array([path]))
            return True
        alike = paths.similarity(path)[others]
        if alike.max() < ALIKE:
            return False
        return self._merge(path, int(others[np.argmax(alike)]), members, before)

    def _merge(self, path: int, other: int, members: NDArray, before: float) -> bool:
        """Let one path explain what two explained, when that lowers F_t."""
        paths = self._paths
        kept = (paths.amplitudes.copy(), paths.positions[other], paths.costs[other])
        others = members[members != path]
        paths.assign(np.array([path]), np.zeros((1, paths.amplitudes.shape[1])))
        _, amplitudes, _ = self._fitted(others)
        paths.assign(others, amplitudes)
        moved = self._refine(other)
        after, amplitudes, _ = self._fitted(others)
        margin = max(MERGING_GAIN - NOISE_PER_FRAME * (len(paths.frames) - 1), 0.0)
        if after < before - LEAST_GAIN - margin * (1 - self._t)**2:
            paths.assign(others, amplitudes)
            if moved:
                self._merged_into.add(paths.ids[other])
            paths.remove(np.array([path]))
            return True
        paths.move(other, kept[1], kept[2])
        paths.assign(np.arange(len(paths)), kept[0])
        return False
