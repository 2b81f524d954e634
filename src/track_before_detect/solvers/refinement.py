"""Positions between the grid: fit a smooth motion to what one path sees.

After a fit on the nearest grid positions the rest of a bright target would pass the threshold as
a ghost, so positions are refined inside the pursuit. A motion is a polynomial in time or the
present path with a displacement; the smoothest that explains the frames wins, since each further
degree costs as much as the turns it replaces.
"""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.climb import best_amplitudes, climb
from track_before_detect.kernels.stamps import statistic_and_slope
from track_before_detect.models.amplitudes import AmplitudeModel
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
    valid : array of bool, shape (T, H, W) or (0, 0, 0)
        Pixels that hold data.
    model : AmplitudeModel
        Of the amplitudes.
    """

    def __init__(self, graph: StateGraph, psf: GaussianPsf, stamps: NDArray,
                 valid: NDArray, model: AmplitudeModel):
        self._graph = graph
        self._psf = psf
        self._valid = valid
        self._model = model
        self._stamps = stamps
        speeds = np.hypot(graph.velocities[:, 0], graph.velocities[:, 1])
        self._max_speed = float(speeds.max()) + graph.velocity_step
        self._moving = float(speeds.max()) > 0 and len(stamps) > 1
        middle = 0.5 * (stamps[0] + stamps[-1])
        half_span = max(0.5 * (stamps[-1] - stamps[0]), 1e-9)
        time = (stamps - middle) / half_span
        legendre = np.polynomial.legendre.legvander(time, HIGHEST_DEGREE)
        degrees = range(1, min(HIGHEST_DEGREE, len(stamps) - 1) + 1) if self._moving else (0,)
        self._polynomials = []
        for degree in degrees:
            basis = np.ascontiguousarray(legendre[:, :degree + 1])
            self._polynomials.append((basis, np.linalg.pinv(basis), degree))
        self._linear = np.ascontiguousarray(legendre[:, :2])
        self._hats = _hat_functions(stamps, stamps[graph.knots[:-1]])
        self._to_hats = np.linalg.pinv(self._hats)

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
        seen = np.empty((len(positions), 3))
        statistic_and_slope(positions, self._psf.sigma_px, self._psf.half_width, frames,
                            self._valid, seen)
        squared = best_amplitudes(seen, self._model.code, np.empty(len(positions)))
        best = (self._gain(squared, cost, threshold, t_convex), positions, cost)
        for start, basis, family_cost in self._candidates(positions, cost):
            moved = np.array(start)
            value = climb(moved, basis, self._psf.sigma_px, self._psf.half_width, frames,
                          self._valid, self._model.code, MOST_STEPS)
            if not self._allowed(moved):
                continue
            moved_cost = family_cost
            if moved_cost is None:
                moved_cost = max(self._turn_cost(moved), self._price(self._hats.shape[1] - 1))
            gain = self._gain(value, moved_cost, threshold, t_convex)
            if gain > best[0]:
                best = (gain, moved, moved_cost)
        return best[1], best[2]

    def _candidates(self, positions: NDArray, cost: float,
                    ) -> Iterator[tuple[NDArray, NDArray, float | None]]:
        """Yield start (T, 2), basis (T, B) and cost of each family; cost None: by its turns."""
        for basis, projection, degree in self._polynomials:
            yield basis @ (projection @ positions), basis, self._price(degree)
        if self._moving:
            # Without the rounding of a path on the grid, which would fit the noise at times.
            yield self._hats @ (self._to_hats @ positions), self._linear, cost
        if self._graph.n_segments > 1:
            yield positions, self._hats, None

    def _gain(self, squared, cost, threshold, t_convex):
        """By how much the path lowers F_t, alone on these frames."""
        weight = self._model.weight(threshold, cost)
        excess = math.sqrt(squared) - t_convex * weight
        return 0.5 * max(excess, 0.0)**2 - 0.5 * (1 - t_convex)**2 * weight**2

    def _price(self, degree):
        """Cost of a motion with as many parameters as a polynomial of this degree."""
        return TURNS_PER_DEGREE * self._graph.turn_cost * max(0, degree - 1)

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
    rows = [np.interp(stamps, nodes, row) for row in np.eye(len(nodes))]
    return np.ascontiguousarray(np.transpose(rows))
