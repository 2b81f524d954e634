"""Positions between the grid: fit a smooth motion to what one path sees.

After a fit on the nearest grid positions the rest of a bright target would pass the threshold as
a ghost, so positions are refined inside the pursuit. A motion is a polynomial in time or the
present path with a displacement; the smoothest that explains the frames wins, since each further
degree costs as much as the turns it replaces.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import stamps as stamp_kernels
from track_before_detect.models.psf import GaussianPsf
from track_before_detect.models.state_graph import StateGraph

# What a degree of a polynomial beyond the first costs, in turns by one velocity step. Each
# degree has two parameters and so gains two units of squared statistic on noise alone.
TURNS_PER_DEGREE = 4.0
HIGHEST_DEGREE = 3
MOST_STEPS = 8


class Refiner:
    """Moves one path to the positions where it explains most.

    Parameters
    ----------
    graph : StateGraph
        Bounds the speed and prices the turns.
    psf : GaussianPsf
        What a target looks like.
    stamps : array, shape (T,)
        In the unit of time of the graph.
    shape : tuple of int
        (H, W).
    valid : array of bool, shape (T, H, W) or (0, 0, 0)
        Pixels that hold data.
    """

    def __init__(self, graph: StateGraph, psf: GaussianPsf, stamps: NDArray,
                 shape: tuple[int, int], valid: NDArray):
        self._graph = graph
        self._psf = psf
        self._valid = valid
        self._limit = np.array([shape[1] - 1, shape[0] - 1], float)
        self._stamps = stamps
        speeds = np.hypot(graph.velocities[:, 0], graph.velocities[:, 1])
        self._max_speed = float(speeds.max()) + graph.velocity_step
        self._moving = float(speeds.max()) > 0
        middle = 0.5 * (stamps[0] + stamps[-1])
        half_span = max(0.5 * (stamps[-1] - stamps[0]), 1e-9)
        time = (stamps - middle) / half_span
        self._polynomials = np.polynomial.legendre.legvander(time, HIGHEST_DEGREE)
        self._hats = _hat_functions(stamps, stamps[graph.knots[:-1]])

    def candidates(self, positions: NDArray, cost: float,
                   ) -> Iterator[tuple[NDArray, NDArray, float | None]]:
        """Yield start (T, 2), basis (T, B) and cost of each family; cost None: by its turns."""
        n_frames = len(positions)
        for degree in range(min(HIGHEST_DEGREE, n_frames - 1) + 1):
            if (degree == 0) == self._moving:
                continue
            basis = self._polynomials[:, :degree + 1]
            coefficients, *_ = np.linalg.lstsq(basis, positions, rcond=None)
            yield (basis @ coefficients, basis,
                   TURNS_PER_DEGREE * self._graph.turn_cost * max(0, degree - 1))
        if n_frames > 2 and self._moving:
            yield positions, self._polynomials[:, :2], cost
        if self._graph.n_segments > 2:
            yield positions, self._hats, None

    def refine(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
               t_convex: float) -> tuple[NDArray, float]:
        """Return better positions and their cost, or those given when none is better.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            What is left of the frames after all other paths.
        positions : array, shape (T, 2)
            x and y in pixels.
        cost : float
            Cost of the turns of the given path.
        threshold : float
            lambda of a path without turns.
        t_convex : float
            Place on the continuation.
        """
        best = (self._gain(self._look(frames, positions)[:, 0], cost, threshold, t_convex),
                positions, cost)
        for start, basis, family_cost in self.candidates(positions, cost):
            moved = self._climb(frames, start, basis)
            moved_cost = self._turn_cost(moved) if family_cost is None else family_cost
            if not self._allowed(moved):
                continue
            gain = self._gain(self._look(frames, moved)[:, 0], moved_cost, threshold, t_convex)
            if gain > best[0]:
                best = (gain, moved, moved_cost)
        return best[1], best[2]

    def _gain(self, statistics, cost, threshold, t_convex):
        """By how much the path lowers F_t, alone on these frames."""
        weight = np.sqrt(threshold**2 + cost)
        excess = np.linalg.norm(np.maximum(statistics, 0)) - t_convex * weight
        return 0.5 * max(excess, 0.0)**2 - 0.5 * (1 - t_convex)**2 * weight**2

    def _look(self, frames, positions):
        out = np.empty((len(positions), 3))
        stamp_kernels.statistic_and_slope(positions, self._psf.sigma_px, self._psf.half_width,
                                          frames, self._valid, out)
        return out

    def _climb(self, frames, positions, basis):
        """Maximise the squared statistic by damped Gauss-Newton steps within the basis."""
        positions = np.clip(positions, 0, self._limit)
        seen = self._look(frames, positions)
        value = np.sum(np.maximum(seen[:, 0], 0)**2)
        damping = 0.0
        for _ in range(MOST_STEPS):
            statistic = np.maximum(seen[:, 0], 0)
            # A unit-norm Gaussian loses d^2 / (4 sigma^2) of its statistic at distance d, so half
            # the squared statistic has this curvature; the floor keeps empty frames harmless.
            curvature = (statistic**2 + 0.1) / (2 * self._psf.sigma_px**2)
            normal = basis.T @ (curvature[:, None] * basis)
            normal += damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(len(normal))
            step = basis @ np.linalg.solve(normal, basis.T @ (statistic[:, None] * seen[:, 1:]))
            largest = np.abs(step).max()
            if largest > self._psf.sigma_px:
                step *= self._psf.sigma_px / largest
            trial = np.clip(positions + step, 0, self._limit)
            trial_seen = self._look(frames, trial)
            trial_value = np.sum(np.maximum(trial_seen[:, 0], 0)**2)
            if trial_value > value:
                gained = trial_value - value
                positions, seen, value = trial, trial_seen, trial_value
                damping *= 0.3
                if gained < 1e-4 * value or largest < 1e-3 * self._psf.sigma_px:
                    break
            else:
                damping = max(4 * damping, 0.5)
        return positions

    def _turn_cost(self, positions):
        """Cost of the turns between segments, as on the grid but for any velocity."""
        knots = self._graph.knots
        if self._graph.n_segments < 2:
            return 0.0
        ends = np.append(knots[1:-1], len(positions) - 1)
        elapsed = self._stamps[ends] - self._stamps[knots[:-1]]
        moved = positions[ends] - positions[knots[:-1]]
        keep = elapsed > 0
        velocity = moved[keep] / elapsed[keep, None]
        steps = np.abs(np.diff(velocity, axis=0)).sum() / self._graph.velocity_step
        return float(self._graph.turn_cost * steps)

    def _allowed(self, positions):
        if len(positions) < 2:
            return True
        velocity = np.diff(positions, axis=0) / np.diff(self._stamps)[:, None]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        # Positions on the grid jump by whole steps; over one interval that is a speed of its own.
        slack = 2 * self._graph.step_px / np.diff(self._stamps)
        return bool(np.all(speed <= self._max_speed + slack))


def _hat_functions(stamps, knots):
    """Piecewise linear functions of time, one for each knot and one for the last stamp."""
    nodes = np.unique(np.append(knots, stamps[-1]))
    return np.array([np.interp(stamps, nodes, row) for row in np.eye(len(nodes))]).T
