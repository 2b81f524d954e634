"""Smooth motions between the grid: families of them, what they cost, which are allowed.

A motion is a polynomial in time or the present path with a displacement; the smoothest that
explains the frames wins, since each further degree costs as much as the turns it replaces.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.motion.coupling import RangeDopplerCoupling
from track_before_detect.models.motion.state_graph import StateGraph

# What a degree of a polynomial beyond the first costs, in turns by one velocity step. Each
# degree has two parameters and so gains two units of squared statistic on noise alone.
TURNS_PER_DEGREE = 4.0
HIGHEST_DEGREE = 3
# A path this many grid steps longer than a target gets at its largest speed costs as much as one
# turn; it grows as the square (docs/constants/refine.md).
OVERLONG_STEPS = 2.5
# Distance from a family up to which a motion belongs to it, px: below any error of a position.
SAME_MOTION_PX = 1e-3


class SmoothMotions(ABC):
    """The motions near a path of a state graph.

    Parameters
    ----------
    graph : StateGraph
        Bounds the speed and prices the turns.
    times : array, shape (T,)
        In the unit of time of the graph.
    """

    def __init__(self, graph: StateGraph, times: NDArray):
        self._graph = graph
        self._times = times
        middle = 0.5 * (times[0] + times[-1])
        half_span = max(0.5 * (times[-1] - times[0]), 1e-9)
        self._legendre = np.polynomial.legendre.legvander(
            (times - middle) / half_span, HIGHEST_DEGREE)
        self._hats = _hat_functions(times, times[graph.knots[:-1]])

    @abstractmethod
    def candidates(self, positions: NDArray, cost: float,
                   ) -> Iterator[tuple[NDArray, NDArray, float | None]]:
        """Yield start (T, 2), basis (T, 2, B) and cost of each family; cost None: by its turns."""

    @abstractmethod
    def families(self, positions: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
        """Yield the nearest motion (T, 2) and the basis (T, 2, B) of each, the smallest first."""

    def families_around(self, positions: NDArray) -> tuple[NDArray, NDArray]:
        """Return the bases of the smallest family that a motion belongs to, and of the largest.

        A motion that belongs to none, as its displacement from another does, was as free as the
        largest.
        """
        families = list(self.families(positions))
        largest = families[-1][1]
        own = (basis for nearest, basis in families
               if np.abs(nearest - positions).max() < SAME_MOTION_PX)
        return next(own, largest), largest

    @abstractmethod
    def allowed(self, positions: NDArray) -> bool:
        """Return whether a target may move like this."""

    @abstractmethod
    def velocities(self, positions: NDArray) -> NDArray:
        """Return the velocity of each segment that a turn changes, any shape (J, ...)."""

    @abstractmethod
    def overspeed_cost(self, positions: NDArray) -> float:
        """Return what a motion costs for being faster than a target should be."""

    def cost(self, positions: NDArray) -> float:
        """Return the cost of a motion, by its turns between segments."""
        if self._graph.n_segments < 2:
            return 0.0
        steps = np.abs(np.diff(self.velocities(positions), axis=0)).sum()
        turns = float(self._graph.turn_cost * steps / self._graph.velocity_step)
        return max(turns, self._price(self._hats.shape[1] - 1))

    def _price(self, degree: int) -> float:
        """Cost of a motion with as many parameters as a polynomial of this degree."""
        return TURNS_PER_DEGREE * self._graph.turn_cost * max(0, degree - 1)

    def _segment_change(self, values: NDArray) -> NDArray:
        """Return the mean rate of change of values (T, ...) over each segment."""
        knots = self._graph.knots
        ends = np.append(knots[1:-1], len(values) - 1)
        elapsed = self._times[ends] - self._times[knots[:-1]]
        change = values[ends] - values[knots[:-1]]
        keep = elapsed > 0
        return change[keep] / elapsed[keep].reshape(-1, *[1] * (values.ndim - 1))


class _PlaneMotions(SmoothMotions):
    """Motions whose two components are free of each other."""

    def __init__(self, graph: StateGraph, times: NDArray):
        super().__init__(graph, times)
        speeds = np.hypot(graph.velocities[:, 0], graph.velocities[:, 1])
        self._max_speed = float(speeds.max()) + graph.velocity_step
        self._moving = float(speeds.max()) > 0 and len(times) > 1
        degrees = range(1, min(HIGHEST_DEGREE, len(times) - 1) + 1) if self._moving else (0,)
        self._polynomials = []
        for degree in degrees:
            basis = self._legendre[:, :degree + 1]
            self._polynomials.append((basis, np.linalg.pinv(basis), _in_plane(basis), degree))
        self._linear = _in_plane(self._legendre[:, :2])
        self._hats_in_plane = _in_plane(self._hats)
        self._to_hats = np.linalg.pinv(self._hats)

    def candidates(self, positions: NDArray, cost: float,
                   ) -> Iterator[tuple[NDArray, NDArray, float | None]]:
        for basis, projection, both, degree in self._polynomials:
            yield basis @ (projection @ positions), both, self._price(degree)
        if self._moving:
            # Without the rounding of a path on the grid, which would fit the noise at times.
            yield self._hats @ (self._to_hats @ positions), self._linear, cost
        if self._graph.n_segments > 1:
            yield positions, self._hats_in_plane, None

    def families(self, positions: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
        for basis, projection, both, _ in self._polynomials:
            yield basis @ (projection @ positions), both
        if self._graph.n_segments > 1 and self._moving:
            yield self._hats @ (self._to_hats @ positions), self._hats_in_plane

    def allowed(self, positions: NDArray) -> bool:
        intervals = np.diff(self._times)
        later = intervals > 0
        moved = np.diff(positions, axis=0)[later]
        speed = np.hypot(moved[:, 0], moved[:, 1]) / intervals[later]
        # Positions on the grid jump by whole steps; over one interval that is a speed of its own.
        slack = 2 * self._graph.step_px / intervals[later]
        return bool(np.all(speed <= self._max_speed + slack))

    def overspeed_cost(self, positions: NDArray) -> float:
        if not self._moving:
            return 0.0
        steps = np.diff(positions, axis=0)
        length = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        farthest = self._graph.max_speed * float(self._times[-1] - self._times[0])
        overlong = max(0.0, length - farthest) / (OVERLONG_STEPS * self._graph.step_px)
        return self._graph.turn_cost * overlong**2

    def velocities(self, positions: NDArray) -> NDArray:
        return self._segment_change(positions)


class _RangeDopplerMotions(SmoothMotions):
    """Motions over range-Doppler maps: the columns of all frames and one range say all."""

    def __init__(self, graph: StateGraph, times: NDArray, coupling: RangeDopplerCoupling):
        super().__init__(graph, times)
        self._max_rate = float(np.abs(graph.velocities[:, 0]).max())
        self._offset = np.zeros((len(times), 2))
        self._offset[:, 1] = -coupling.rows_per_column * coupling.still_column * coupling.times
        highest = min(HIGHEST_DEGREE, len(times) - 1) if self._max_rate > 0 else 0
        families: list[tuple[NDArray, float | None]] = [
            (self._legendre[:, :degree + 1], self._price(degree))
            for degree in range(highest + 1)]
        if graph.n_segments > 1 and self._max_rate > 0:
            families.append((self._hats, None))
        self._families = []
        for columns, price in families:
            basis = _with_rows(columns, times, coupling.rows_per_column)
            self._families.append((basis, np.linalg.pinv(basis.reshape(2 * len(times), -1)),
                                   price))

    def candidates(self, positions: NDArray, cost: float,
                   ) -> Iterator[tuple[NDArray, NDArray, float | None]]:
        for basis, projection, price in self._families:
            parameters = projection @ (positions - self._offset).ravel()
            yield self._offset + basis @ parameters, basis, price

    def families(self, positions: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
        for nearest, basis, _ in self.candidates(positions, 0.0):
            yield nearest, basis

    def allowed(self, positions: NDArray) -> bool:
        if len(positions) < 2:
            return True
        rate = np.diff(positions[:, 0]) / np.diff(self._times)
        return bool(np.all(np.abs(rate) <= self._max_rate + self._graph.velocity_step))

    def overspeed_cost(self, positions: NDArray) -> float:
        # The columns of a map say how fast a target may be.
        return 0.0

    def velocities(self, positions: NDArray) -> NDArray:
        return self._segment_change(positions[:, 0])


def motions_of(graph: StateGraph, times: NDArray) -> SmoothMotions:
    """Return the motions that belong to a state graph."""
    if graph.coupling is not None:
        return _RangeDopplerMotions(graph, times, graph.coupling)
    return _PlaneMotions(graph, times)


def _with_rows(columns: NDArray, times: NDArray, rows_per_column: float) -> NDArray:
    """Return the basis (T, 2, B + 1) of motions whose columns have the basis (T, B)."""
    steps = 0.5 * (columns[1:] + columns[:-1]) * np.diff(times)[:, None]
    integral = np.vstack([np.zeros(columns.shape[1]), np.cumsum(steps, axis=0)])
    basis = np.zeros((len(times), 2, columns.shape[1] + 1))
    basis[:, 0, :-1] = columns
    basis[:, 1, :-1] = rows_per_column * integral
    basis[:, 1, -1] = 1.0
    return basis


def _in_plane(basis: NDArray) -> NDArray:
    """Return a basis (T, B) of displacements as one (T, 2, 2 B) in x and y, each for itself."""
    nothing = np.zeros_like(basis)
    return np.ascontiguousarray(np.stack(
        [np.hstack([basis, nothing]), np.hstack([nothing, basis])], axis=1))


def _hat_functions(times: NDArray, knots: NDArray) -> NDArray:
    """Piecewise linear functions of time, one for each knot and one for the last moment."""
    nodes = np.unique(np.append(knots, times[-1]))
    rows = [np.interp(times, nodes, row) for row in np.eye(len(nodes))]
    return np.ascontiguousarray(np.transpose(rows))
