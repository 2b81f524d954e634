"""Constant velocities on a grid, and the plan of the sums that stacking over them shares."""

from dataclasses import dataclass
from functools import cached_property
import hashlib
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.motion.coupling import whole_steps

# Displacement over the whole batch between neighbouring velocities, in pixels. A target between
# two velocities drifts off the nearer one by at most half of this over the batch.
PIXELS_PER_BATCH = 1.0
# Velocities and positions along each axis that an effective area is summed over at most.
MOST_VELOCITIES = 13
MOST_POSITIONS = 64
# Frames whose sums are tried as shared ones.
GROUPS = (1, 2, 3, 4, 5, 6, 8)


class StackPlan(NamedTuple):
    """Sums of rows that velocities share, as the kernel ``velocity_stack`` takes them.

    Sources are of shape (N, 2), the other nodes (N,), both finals (Vx, G).
    """

    node_sources: NDArray[np.int32]
    node_shifts: NDArray[np.int32]
    node_first: NDArray[np.int32]
    node_last: NDArray[np.int32]
    final_sources: NDArray[np.int32]
    final_shifts: NDArray[np.int32]

    @property
    def n_additions(self) -> int:
        """Rows that are added up for all v_x; stacking each on its own takes Vx (T - 1)."""
        return len(self.node_sources) + self.final_sources.size - len(self.final_sources)


@dataclass(frozen=True)
class VelocityGrid:
    """Velocities on a square grid within a disc, seen from the middle of the batch.

    Attributes
    ----------
    times : array, shape (T,)
        Seconds from the middle of the batch.
    axis : array, shape (n,)
        Values of v_x and of v_y in pixels per second.
    first_vx, last_vx : array of int32, shape (n,)
        Which v_x go with each v_y.
    moves : array of int32, shape (n, T)
        Displacement of each value in whole pixels.
    """

    times: NDArray[np.float64]
    axis: NDArray[np.float64]
    first_vx: NDArray[np.int32]
    last_vx: NDArray[np.int32]
    moves: NDArray[np.int32]

    @property
    def n_velocities(self) -> int:
        """Velocities of the grid."""
        return int(np.sum(self.last_vx - self.first_vx))

    @cached_property
    def plan(self) -> StackPlan:
        """Plan of the sums along x that takes the fewest additions."""
        return min((_plan(self.moves, group) for group in GROUPS),
                   key=lambda plan: plan.n_additions)

    @property
    def step(self) -> float:
        """Distance of neighbouring velocities in pixels per second, 0 for a single one."""
        return float(self.axis[1] - self.axis[0]) if len(self.axis) > 1 else 0.0

    @property
    def key(self) -> str:
        """Text that differs between grids that are searched differently."""
        parts = (self.moves, self.first_vx, self.last_vx)
        return hashlib.sha256(b''.join(part.tobytes() for part in parts)).hexdigest()[:32]

    def velocity(self, number: int) -> NDArray[np.float64]:
        """Return (v_x, v_y) of a velocity by its number in the compiled loop."""
        i, j = divmod(number, len(self.axis))
        return np.array([self.axis[j], self.axis[i]])

    def effective_area(self, shape: tuple[int, int]) -> float:
        """Return to how many pixels (H, W) comes, seen by a target that never leaves.

        In noise the statistic of a line is a smooth random field over position and velocity. Its
        maxima above a level are in proportion to the root of the determinant of the covariance
        of its slope (Rice's formula), which is the variance of the times at which the line is
        inside, once for each axis.
        """
        spread = float(np.var(self.times))
        if spread == 0 or len(self.axis) == 1:
            return float(shape[0] * shape[1])
        number = np.unique(np.linspace(0, len(self.axis) - 1, MOST_VELOCITIES).round().astype(int))
        inside = [self._inside(length, number) for length in shape]
        total, count = 0.0, 0
        for rows, i in zip(inside[0], number, strict=True):
            for columns, j in zip(inside[1], number, strict=True):
                if not self.first_vx[i] <= j < self.last_vx[i]:
                    continue
                n, mean, square = (np.maximum((rows * self.times**power) @ columns.T, least)
                                   for power, least in ((0, 1.0), (1, -np.inf), (2, 0.0)))
                total += float(np.mean(square / n - (mean / n)**2))
                count += 1
        return shape[0] * shape[1] * total / (count * spread)

    def _inside(self, length: int, number: NDArray) -> NDArray[np.float64]:
        """Return where on an axis and when lines are inside, by velocity, (V, N, T)."""
        n_positions = min(length, MOST_POSITIONS)
        middle = (np.arange(n_positions) + 0.5) * length / n_positions - 0.5
        at = middle[:, None] + self.axis[number][:, None, None] * self.times
        return ((at >= -0.5) & (at <= length - 0.5)).astype(float)


def velocity_grid(stamps: NDArray, max_speed: float, *, disc: bool = True) -> VelocityGrid:
    """Return the velocities up to a speed.

    Parameters
    ----------
    stamps : array, shape (T,)
        Seconds, strictly increasing.
    max_speed : float
        Pixels per second.
    disc : bool
        Whether the largest speed bounds the length of the velocity, or each component.
    """
    span = float(stamps[-1] - stamps[0])
    times = np.asarray(stamps, np.float64) - 0.5 * float(stamps[0] + stamps[-1])
    count = math.floor(max_speed * span / PIXELS_PER_BATCH + 1e-9)
    axis = np.arange(-count, count + 1.0) * (PIXELS_PER_BATCH / span if count else 0.0)
    half = np.full(len(axis), count)
    if disc and count:
        radius = max_speed * span / PIXELS_PER_BATCH + 1e-9
        half = np.floor(np.sqrt(radius**2 - np.arange(-count, count + 1)**2) + 1e-9).astype(int)
    return VelocityGrid(times, axis, (count - half).astype(np.int32),
                        (count + half + 1).astype(np.int32), whole_steps(axis[:, None] * times))


class _Sums:
    """Sums of the rows of successive frames, shifted against each other."""

    def __init__(self, n_frames: int):
        self._n_frames = n_frames
        self.numbers: dict[tuple[int, tuple[int, ...]], int] = {}
        self.sources: list[tuple[int, int]] = []
        self.shifts: list[int] = []
        self.used: list[list[int]] = []

    def number(self, first: int, pattern: tuple[int, ...], shift: int) -> int:
        """Return the number of the sum of the frames from ``first`` on, used at a shift.

        ``pattern`` holds the shift of each frame against the first.
        """
        if len(pattern) == 1:
            return first
        middle = len(pattern) // 2
        step = pattern[middle]
        left = self.number(first, pattern[:middle], shift)
        right = self.number(first + middle, tuple(p - step for p in pattern[middle:]),
                            shift + step)
        key = (first, pattern)
        if key not in self.numbers:
            self.numbers[key] = len(self.sources)
            self.sources.append((left, right))
            self.shifts.append(step)
            self.used.append([shift, shift])
        used = self.used[self.numbers[key]]
        used[0], used[1] = min(used[0], shift), max(used[1], shift)
        return self._n_frames + self.numbers[key]


def _plan(moves: NDArray, group: int) -> StackPlan:
    """Return the plan with sums over at most about ``group`` frames."""
    n_frames = moves.shape[1]
    n_groups = max(1, round(n_frames / group))
    bounds = np.rint(np.linspace(0, n_frames, n_groups + 1)).astype(int).tolist()
    sums = _Sums(n_frames)
    finals = []
    for row in moves.tolist():
        finals.append([(sums.number(a, tuple(m - row[a] for m in row[a:b]), row[a]), row[a])
                       for a, b in zip(bounds[:-1], bounds[1:], strict=True)])
    used = np.array(sums.used, np.int32).reshape(-1, 2)
    final = np.array(finals, np.int32)
    return StackPlan(np.array(sums.sources, np.int32).reshape(-1, 2),
                     np.array(sums.shifts, np.int32), used[:, 0].copy(), used[:, 1].copy(),
                     final[:, :, 0].copy(), final[:, :, 1].copy())
