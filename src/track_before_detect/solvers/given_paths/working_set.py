"""The few of the given paths that have amplitudes, grown until no path is missing."""

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.fit import given_paths as kernels
from track_before_detect.kernels.fit import group_lasso
from track_before_detect.kernels.fit.least_squares import find_blocks
from track_before_detect.solvers.given_paths import admm
from track_before_detect.solvers.given_paths.problem import FittedPaths, Problem
from track_before_detect.types import Step

MOST_ROUNDS = 200
# How the working set is solved, and in how many rounds at most.
METHODS: dict[str, tuple[Callable, int]] = {
    'newton': (group_lasso.solve, 200),
    'descent': (group_lasso.descend, 50000),
    'admm': (admm.solve, 20000),
}
# New members of the working set in one round at least, and those looked at to choose them.
FEWEST_NEW = 16
CANDIDATES_PER_NEW = 20
# Mean overlap from which two new members count as the same for the moment.
ALIKE = 0.95
# Members without amplitude are dropped below this share of their bound, in the first rounds.
NEARLY = 0.97
MOST_PRUNED_ROUNDS = 50
# Share of its bound from which the statistic of a path is watched in every round.
FOCUS = 0.95
# Members up to which it does not pay to look for those that never meet.
SOLVED_AT_ONCE = 100
# Share of the gap over all paths, and of the gap asked for, that the working set is solved to.
INNER_SHARE = 0.02
FINAL_SHARE = 0.3


class WorkingSet:
    """The few paths that have amplitudes, or were worth a try, and how they overlap."""

    def __init__(self, problem: Problem, lam: float, t: float):
        self._problem = problem
        self._lam = lam
        self._t = t
        self._weight = t * lam
        n_parts, n_frames = problem.data.shape[:2]
        self._members = np.empty(0, np.int64)
        self._amplitudes = np.empty((0, n_parts, n_frames))
        self._gram = np.empty((0, 0, n_frames))
        # Paths whose statistics are computed in every round, and the columns they use.
        self._all_paths = np.arange(problem.n_paths)
        self._all_columns = np.arange(problem.n_columns)
        self._watched = self._all_paths
        self._columns = self._all_columns
        self._correlations = np.zeros((n_parts, problem.n_columns))
        self._statistics = np.zeros(problem.n_paths)

    def run(self, tol: float, method: str) -> FittedPaths:
        """Solve the convex part to a relative duality gap and return the fit."""
        problem, weight = self._problem, self._weight
        history: list[Step] = []
        status = 'iteration_limit'
        residual = problem.data
        before, grew = math.inf, True
        for round_ in range(MOST_ROUNDS):
            if round_:
                residual = problem.residual(self._members, self._unweighted())
            norms = np.sqrt(np.einsum('pdt,pdt->p', self._amplitudes, self._amplitudes))
            convex, gap, largest = self._evaluate(residual, norms)
            if round_ == 0:
                of_data = self._correlations.copy()
            done = gap <= tol * convex
            stuck = not grew and gap >= before
            if (done or stuck or round_ == MOST_ROUNDS - 1) and not self._all_watched:
                self._watched, self._columns = self._all_paths, self._all_columns
                convex, gap, largest = self._evaluate(residual, norms)
                done = gap <= tol * convex
            n_active = int(np.count_nonzero(norms))
            objective = convex + 0.5 * (1 - self._t)**2 * self._lam**2 * n_active
            violation = largest / self._lam - self._t
            history.append(Step(self._t, objective, n_active, violation))
            if done:
                status = 'converged'
                break
            if round_ < MOST_PRUNED_ROUNDS:
                self._keep(np.flatnonzero(
                    (norms > 0) | (self._statistics[self._members] > NEARLY * weight)))
            grew = self._grow()
            if stuck and not grew and self._all_watched:
                break
            if self._all_watched:
                self._focus()
            before = gap
            # Solving a small set to the last digit before it is complete would be in vain.
            wanted = max(INNER_SHARE * gap, FINAL_SHARE * tol * convex) if grew else 0.1 * gap
            matched = np.ascontiguousarray(
                of_data[:, problem.columns[self._members]].transpose(1, 0, 2))
            if problem.weights is not None:
                matched /= problem.weights[self._members][:, None]
            self._solve(matched, wanted, method)
        return problem.fitted(self._members, self._unweighted(),
                              gap if self._t == 1.0 else math.nan, status, history)

    def _unweighted(self) -> NDArray[np.float64]:
        if self._problem.weights is None:
            return self._amplitudes
        return self._amplitudes / self._problem.weights[self._members][:, None]

    def _solve(self, matched: NDArray, wanted: float, method: str) -> None:
        """Solve over the members to a duality gap; paths that never meet are solved apart."""
        if len(matched) <= SOLVED_AT_ONCE:
            self._solve_members(slice(None), matched, self._gram, wanted, method)
            return
        order, ends = np.empty(len(matched), np.int64), np.empty(len(matched), np.int64)
        n_clusters = find_blocks(self._gram.any(axis=2).astype(float), order, ends)
        for cluster in np.split(order, ends[:n_clusters - 1]):
            rows = np.sort(cluster)
            self._solve_members(rows, matched[rows], self._gram[np.ix_(rows, rows)],
                                wanted / n_clusters, method)

    def _solve_members(self, rows: NDArray | slice, matched: NDArray, gram: NDArray,
                       wanted: float, method: str) -> None:
        amplitudes = self._amplitudes[rows]
        solve, most_rounds = METHODS[method]
        solve(amplitudes, matched, gram, np.empty_like(matched), self._weight,
              self._problem.non_negative, self._problem.energy, wanted, most_rounds)
        self._amplitudes[rows] = amplitudes

    @property
    def _all_watched(self) -> bool:
        return len(self._watched) == self._problem.n_paths

    def _evaluate(self, residual: NDArray, norms: NDArray) -> tuple[float, float, float]:
        """Return the convex objective, its gap and the largest statistic of the paths watched."""
        problem, weight = self._problem, self._weight
        problem.correlate(residual, self._columns, self._correlations)
        largest = problem.fill_statistics(self._watched, self._correlations, self._statistics)
        energy = float(np.vdot(residual, residual))
        convex = 0.5 * energy + weight * float(norms.sum())
        dual = group_lasso.dual_value(float(np.vdot(problem.data, residual)), energy, largest,
                                      weight)
        return convex, max(convex - dual, 0.0), largest

    def _focus(self) -> None:
        """Watch only the paths near their bound until these are solved: it is most of the time.

        Before the end all paths are watched again, so nothing is lost by a wrong guess.
        """
        near = self._statistics > FOCUS * self._weight
        near[self._members] = True
        self._watched = np.flatnonzero(near)
        self._columns = kernels.columns_of(self._watched, self._problem.columns,
                                           self._problem.n_columns)

    def _keep(self, rows: NDArray) -> None:
        """Drop all other members."""
        if len(rows) < len(self._members):
            self._members = self._members[rows]
            self._amplitudes = self._amplitudes[rows]
            self._gram = self._gram[np.ix_(rows, rows)]

    def _grow(self) -> bool:
        """Add the paths that violate their bound most; True when there were any."""
        problem = self._problem
        violates = self._statistics > self._weight
        violates[self._members] = False
        violating = self._watched[violates[self._watched]]
        if not len(violating):
            return False
        most = max(FEWEST_NEW, len(self._members))
        order = np.argsort(-self._statistics[violating])[:CANDIDATES_PER_NEW * most]
        candidates = violating[order]
        new = candidates[kernels.pick_distinct(problem.places(candidates), most, ALIKE,
                                               problem.stamps, problem.origins)]
        n_old = len(self._members)
        n_all = n_old + len(new)
        gram = np.empty((n_all, n_all, self._gram.shape[2]))
        gram[:n_old, :n_old] = self._gram
        self._members = np.concatenate([self._members, new])
        problem.fill_gram(problem.places(self._members), n_old, gram)
        if problem.weights is not None:
            # Columns over their weights, whose amplitudes are W x, have the one weight t lam.
            weights = problem.weights[self._members]
            gram[n_old:] /= weights[n_old:, None] * weights
            gram[:n_old, n_old:] /= weights[:n_old, None] * weights[n_old:]
        self._gram = gram
        self._amplitudes = np.concatenate(
            [self._amplitudes, np.zeros((len(new), *self._amplitudes.shape[1:]))])
        return True
