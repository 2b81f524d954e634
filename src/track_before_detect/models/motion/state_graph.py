"""Which paths a target may take: the discretised state space and its transitions.

A path runs straight for a segment of several frames and may change its velocity between two
segments by few steps of the velocity grid. The best graph turns as fast as the target may and no
faster: every further turn it allows is another way to follow the noise. Searching whole segments
also costs less than searching frame by frame, for the sum over a segment needs no maximum.
"""

from __future__ import annotations

import builtins
from dataclasses import dataclass, replace
import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.motion.coupling import RangeDopplerCoupling, whole_steps

# Displacement over one segment between neighbouring velocities, in grid steps. With three, a
# target between two velocities drifts off its segment by at most three quarters of a step at
# either end.
STEPS_PER_SEGMENT = 3.0


@dataclass(frozen=True)
class StateGraph:
    """States (position, velocity) and the transitions between them.

    The detectors count time in median intervals of the frames.

    Attributes
    ----------
    step_px : float
        Distance of neighbouring positions in pixels.
    knots : array of int, shape (J + 1,)
        First frame of each of the J segments, and the number of frames.
    velocities : array, shape (V, 2)
        v_x, v_y in pixels per unit of time.
    velocity_step : float
        Distance of neighbouring velocities in pixels per unit of time.
    reach : int
        Steps by which either component may change between two segments.
    row_first, row_x : array of int32, shape (R + 1,) and (R,)
        Rows of equal v_y: number of the first velocity and grid index of its v_x.
    moves : array of int32, shape (T, V, 2)
        Displacement in steps from the start of its segment to each frame.
    end_moves : array of int32, shape (J, V, 2)
        Displacement over each segment.
    turn_cost : float
        What a change of velocity by one step costs a path, in units of its value.
    max_speed : float
        Largest speed of a target in pixels per unit of time. The grid of velocities goes on a
        little beyond it, so that a path of the grid is near every target.
    coupling : RangeDopplerCoupling, optional
        How the column of a target moves its row; all moves are then those in the sheared plane.
    """

    step_px: float
    knots: NDArray[np.int64]
    velocities: NDArray[np.float64]
    velocity_step: float
    reach: int
    row_first: NDArray[np.int32]
    row_x: NDArray[np.int32]
    moves: NDArray[np.int32]
    end_moves: NDArray[np.int32]
    turn_cost: float
    max_speed: float
    coupling: RangeDopplerCoupling | None = None

    @property
    def n_frames(self) -> int:
        """Frames of the batch."""
        return int(self.knots[-1])

    @property
    def n_segments(self) -> int:
        """Segments of the batch."""
        return len(self.knots) - 1

    @property
    def n_velocities(self) -> int:
        """Velocities of the grid."""
        return len(self.velocities)

    @property
    def grid(self) -> NDArray[np.int64]:
        """Place of each velocity on the grid of velocities, shape (V, 2)."""
        lengths = np.diff(self.row_first)
        rows = np.repeat(np.arange(len(lengths)), lengths)
        columns = np.arange(self.n_velocities) - self.row_first[rows] + self.row_x[rows]
        return np.stack([columns, rows], axis=1)

    def slice(self, frames: builtins.slice) -> StateGraph:
        """Return the graph of some successive frames: its paths are those of this one, cut."""
        first, stop, _ = frames.indices(self.n_frames)
        began = np.searchsorted(self.knots, first, side='right') - 1
        ended = np.searchsorted(self.knots, stop, side='left')
        moves, end_moves = self.moves[first:stop].copy(), self.end_moves[began:ended].copy()
        if stop < self.knots[ended]:
            end_moves[-1] = self.moves[stop]
        # The segment that is cut begins where the path is by then.
        moved = self.moves[first].copy()
        end_moves[0] -= moved
        moves[:self.knots[began + 1] - first] -= moved
        return replace(
            self, knots=np.clip(self.knots[began:ended + 1], first, stop) - first, moves=moves,
            end_moves=end_moves, coupling=self.coupling and self.coupling.slice(frames))

    def effective_area(self, shape: tuple[int, int], around: bool = False) -> float:
        """Return the pixels of a frame (H, W) where a straight path can start and stay inside.

        With ``around`` the columns go round, so that no path leaves at either side.
        """
        if self.coupling is not None:
            room = shape[0] - self.coupling.travel(shape[1])
            return float(np.sum(np.maximum(room, 0.5)))
        return float(self.rooms(shape, around).prod(axis=1).mean())

    def rooms(self, shape: tuple[int, int], around: bool = False,
              share: float = 1.0) -> NDArray[np.float64]:
        """Return width and height (V, 2) of where a straight path of each velocity can start.

        A path that lasts a share of the batch may end sooner.
        """
        extent = share * self.step_px * np.abs(self.end_moves.sum(axis=0))
        extent[:, 0] *= not around
        return np.maximum(np.array([shape[1], shape[0]]) - extent, 0.5)

    def fingerprint(self) -> str:
        """Return a text that differs between graphs with different paths or costs."""
        digest = hashlib.sha256(repr((
            self.reach, self.turn_cost, self.step_px, self.max_speed, self.coupling)).encode())
        for array in (self.knots, self.row_first, self.row_x, self.moves, self.end_moves):
            digest.update(np.ascontiguousarray(array, dtype=np.int64).tobytes())
        return digest.hexdigest()


def build_state_graph(stamps: NDArray, *, step_px: float, max_speed: float,
                      max_acceleration: float, turn_cost: float) -> StateGraph:
    """Discretise nearly constant velocity.

    Parameters
    ----------
    stamps : array, shape (T,)
        In any unit of time, increasing; frames of several sensors may share a stamp.
    step_px : float
        Distance of neighbouring positions in pixels.
    max_speed : float
        Pixels per unit of time.
    max_acceleration : float
        Pixels per unit of time squared; 0 allows no turn.
    turn_cost : float
        Cost of one velocity step at a turn.
    """
    n_frames = len(stamps)
    moments = np.unique(stamps)
    interval = float(np.median(np.diff(moments))) if len(moments) > 1 else 1.0
    span = float(stamps[-1] - stamps[0]) + interval
    if max_acceleration > 0 and max_speed > 0:
        duration = math.sqrt(STEPS_PER_SEGMENT * step_px / max_acceleration)
    else:
        duration = span
    n_segments = min(max(1, round(span / max(duration, interval))), len(moments))
    starts = stamps[0] + span / n_segments * np.arange(n_segments)
    knots = np.searchsorted(stamps, starts - 1e-6 * interval)
    knots = np.unique(np.append(knots, n_frames))
    n_segments = len(knots) - 1

    if n_segments == len(moments):
        # Each moment is a segment of its own: a finer step than one position would not be seen.
        velocity_step = step_px / interval
    elif n_segments == 1:
        velocity_step = STEPS_PER_SEGMENT * step_px / max(span - interval, interval)
    else:
        velocity_step = STEPS_PER_SEGMENT * step_px / (span / n_segments)
    grid, row_first, row_x = _disc(max_speed / velocity_step)
    reach = max(1, round(max_acceleration * span / n_segments / velocity_step))
    reach = min(reach, max(1, 2 * int(grid.max())))
    velocities = grid * velocity_step

    moves = np.zeros((n_frames, len(grid), 2), np.int32)
    end_moves = np.zeros((n_segments, len(grid), 2), np.int32)
    ends = np.append(stamps, stamps[-1] + interval)[knots[1:]]
    for j in range(n_segments):
        elapsed = stamps[knots[j]:knots[j + 1]] - stamps[knots[j]]
        moves[knots[j]:knots[j + 1]] = whole_steps(elapsed[:, None, None] * velocities / step_px)
        end_moves[j] = whole_steps((ends[j] - stamps[knots[j]]) * velocities / step_px)
    return StateGraph(step_px, knots, velocities, velocity_step, reach, row_first, row_x,
                      moves, end_moves, float(turn_cost), float(max_speed))


def regular_stamps(stamps: NDArray) -> NDArray[np.float64]:
    """Return stamps in units of their median interval, each interval rounded to quarters of it.

    So the jitter of a clock does not ask for a calibration of its own.
    """
    if len(stamps) < 2:
        return np.zeros(len(stamps))
    intervals = np.diff(stamps)
    quarters = np.maximum(np.rint(4 * intervals / np.median(intervals)), 1) / 4
    return np.append(0.0, np.cumsum(quarters))


def exact_stamps(stamps: NDArray) -> NDArray[np.float64]:
    """Return stamps in units of the median interval between those that differ.

    For frames of several sensors, whose moments fall anywhere between each other's.
    """
    intervals = np.diff(np.unique(stamps))
    return (stamps - stamps[0]) / (np.median(intervals) if len(intervals) else 1.0)


def _disc(radius: float) -> tuple[NDArray, NDArray[np.int32], NDArray[np.int32]]:
    """Return the grid points within ``radius`` and half a step, row by row."""
    outer = radius + 0.5 if radius > 0 else 0.0
    extent = math.floor(outer)
    rows = []
    for i_y in range(-extent, extent + 1):
        half = math.floor(math.sqrt(max(outer**2 - i_y**2, 0.0)) + 1e-9)
        rows.append([(i_x, i_y) for i_x in range(-half, half + 1)])
    row_first = np.cumsum([0] + [len(row) for row in rows]).astype(np.int32)
    row_x = np.array([row[0][0] + extent for row in rows], np.int32)
    return np.array([point for row in rows for point in row], float), row_first, row_x
