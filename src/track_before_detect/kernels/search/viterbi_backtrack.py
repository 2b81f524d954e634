"""Pick the best ends of paths in the tables of the module ``viterbi``, and follow them back."""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.compile_flags import EXACT, ZERO
from track_before_detect.kernels.rows import ABSENT
from track_before_detect.kernels.search.borrowed_arrays import borrowed
from track_before_detect.kernels.search.viterbi import Turns

# A start that is on no grid.
NOWHERE = -2**40


class Motion(NamedTuple):
    """All segments of a state graph; fields as of the graph.

    Attributes
    ----------
    knots : array of int64, shape (J + 1,)
    moves, end_moves : array of int64, shape (T, V, 2) and (J, V, 2)
    kinds : array of int64, shape (V,)
        Which of several scores is that of a velocity.
    turns : Turns
    entry, leaving : float32
        Cost of beginning after the first frame and of ending before the last; as large as a
        number that is ``ABSENT`` where that may not be.
    """

    knots: NDArray[np.int64]
    moves: NDArray[np.int64]
    end_moves: NDArray[np.int64]
    kinds: NDArray[np.int64]
    turns: Turns
    entry: np.float32
    leaving: np.float32


@numba.njit(**EXACT)
def _borrowed(motion):
    """Return the same motion; each use of a tuple counts references to the arrays it owns."""
    turns = motion.turns
    return Motion(
        borrowed(motion.knots), borrowed(motion.moves), borrowed(motion.end_moves),
        borrowed(motion.kinds),
        Turns(borrowed(turns.slots), borrowed(turns.velocity_at), turns.columns, turns.reach,
              turns.cost), motion.entry, motion.leaving)


@numba.njit(**EXACT)
def _find_arriving(arriving, tables, places, j, y, x, motion, layout):
    """Write to arriving[v] the weight of the best path that comes to (y, x) at velocity v.

    By the start of segment j; absent where there is none, and beyond the last velocity.
    """
    for v in range(layout.n_v):
        row, column = y - motion.end_moves[j - 1, v, 1], x - motion.end_moves[j - 1, v, 0]
        arriving[v] = ABSENT
        if (0 <= row < layout.n_y and 0 <= column < layout.n_x and places[j - 1, row, v]):
            arriving[v] = tables[places[j - 1, row, v] + column]
    arriving[layout.n_v] = ABSENT


@numba.njit(**EXACT, inline='always')
def _best_arrival(arriving, j, v, may):
    """Return how the best path comes to go on at velocity v in segment j.

    arriving : float32 (V + 1,), as ``_find_arriving`` writes it

    Returns
    -------
    int
        Velocity in the segment before.
    float
        Weight of the path so far, less the cost of the turn.
    int
        Steps of the turn.
    """
    best, chosen, turned = ABSENT, -1, 0
    if j == 0:
        return chosen, np.float32(0), turned
    for k in range(-may.reach, may.reach + 1):
        for m in range(-may.reach, may.reach + 1):
            other = may.velocity_at[may.slots[v] + k * may.columns + m]
            steps = abs(k) + abs(m)
            weight = arriving[other] - np.float32(steps) * may.cost
            if weight > best:
                best, chosen, turned = weight, other, steps
    return chosen, best, turned


@numba.njit(**EXACT, inline='always')
def _live_on(reached, scores, t, y, x, v, motion, layout):
    """Return what a path that starts its segment at (y, x) has reached after frame t."""
    row, column = y + motion.moves[t, v, 1], x + motion.moves[t, v, 0]
    met = ABSENT
    if 0 <= row < layout.n_y and 0 <= column < layout.n_x:
        frame = motion.kinds[v] * motion.moves.shape[0] + t
        met = scores[layout.pad + (frame * layout.n_y + row) * layout.stride + column]
    return max(reached, -motion.entry) + met


@numba.njit(**EXACT)
def _best_end(arriving, scores, j, y, x, motion, layout):
    """Return how the best path that starts its last segment j at (y, x) goes on.

    Returns
    -------
    int, int
        Velocity and last frame.
    float
        Its weight, of what it meets in the last segment in double precision.
    """
    motion = _borrowed(motion)
    best, velocity, last = ABSENT, ZERO, motion.knots[j + 1] - 1
    for v in range(layout.n_v):
        _, reached, _ = _best_arrival(arriving, j, v, motion.turns)
        for t in range(motion.knots[j], motion.knots[j + 1]):
            reached = _live_on(reached, scores, t, y, x, v, motion, layout)
            end = reached if t == motion.moves.shape[0] - 1 else reached - motion.leaving
            if end > best:
                best, velocity, last = end, v, t
    _, reached, _ = _best_arrival(arriving, j, velocity, motion.turns)
    value = np.float64(reached)
    for t in range(motion.knots[j], last + 1):
        value = _live_on(value, scores, t, y, x, velocity, motion, layout)
    if last < motion.moves.shape[0] - 1:
        value -= motion.leaving
    return velocity, last, value


@numba.njit(**EXACT)
def _follow_back(positions, velocities, starts, tables, places, scores, j, y, x, velocity, last,
                stop, motion, layout):
    """Write positions and velocities of the best path that is at (y, x) when segment j starts.

    Parameters
    ----------
    positions : float64 (T, 2)
        Receives x and y in grid steps, where the path is present.
    velocities : int64 (T,)
        Receives the velocity there.
    starts : int64 (J, 2)
        Receives x and y of its starts of segments.
    tables : float32, flat
    places : int64 (J - 1, Y, V)
        Where the states of each segment but the last lie in the tables, as in the module
        ``viterbi``.
    velocity, last : int
        In segment j, and the last frame there.
    stop : int
        Segment at whose start it is followed no further.

    Returns
    -------
    int, int, int, int
        The segment that is left to be followed, y, x and velocity there; below zero where the path
        is no more.
    int
        Steps of its turns.
    """
    motion = _borrowed(motion)
    arriving = np.empty(layout.n_v + 1, np.float32)
    turns = 0
    while j > stop or j == 0:
        first = motion.knots[j]
        if j > 0:
            _find_arriving(arriving, tables, places, j, y, x, motion, layout)
        before, reached, turned = _best_arrival(arriving, j, velocity, motion.turns)
        entered = first
        goes_on = j > 0 and reached > -motion.entry
        for t in range(first, last + 1):
            if t > first and reached <= -motion.entry:
                entered, goes_on = t, False
            reached = _live_on(reached, scores, t, y, x, velocity, motion, layout)
        starts[j, 0], starts[j, 1] = x, y
        for t in range(entered, last + 1):
            positions[t, 0] = x + motion.moves[t, velocity, 0]
            positions[t, 1] = y + motion.moves[t, velocity, 1]
            velocities[t] = velocity
        if not goes_on:
            for earlier in range(j):
                starts[earlier, 0] = starts[earlier, 1] = NOWHERE
            return -1, y, x, velocity, turns
        turns += turned
        velocity, j, last = before, j - 1, first - 1
        x -= motion.end_moves[j, velocity, 0]
        y -= motion.end_moves[j, velocity, 1]
    return j, y, x, velocity, turns


@numba.njit(**EXACT)
def trace_paths(positions, velocities, starts, values, left, tables, places, scores, j, ends, stop,
                motion, layout):
    """Follow N paths back from where they start their last segment j, the best to each place.

    Parameters
    ----------
    positions, velocities, starts
        Receive what ``_follow_back`` writes, one path after the other, and ``starts`` those of
        segments that the paths would go on to as well.
    values : float64 (N,)
        Receives their weights, of what they meet in the last segment in double precision.
    left : int64 (N, 5)
        Receives what ``_follow_back`` returns. A path that has a segment left goes on there.
    ends : int64 (N, 2)
        y and x at the start of the segment.
    tables, places, stop
        As of ``_follow_back``.
    """
    motion = _borrowed(motion)
    arriving = np.empty(layout.n_v + 1, np.float32)
    for i in range(len(ends)):
        segment, y, x = left[i, 0], left[i, 1], left[i, 2]
        velocity, turns = left[i, 3], left[i, 4]
        last = motion.knots[segment + 1] - 1
        if segment == 0:
            segment, turns, y, x = j, 0, ends[i, 0], ends[i, 1]
            if j > 0:
                _find_arriving(arriving, tables, places, j, y, x, motion, layout)
            velocity, last, values[i] = _best_end(arriving, scores, j, y, x, motion, layout)
            starts[i, j, 0], starts[i, j, 1] = x, y
            for later in range(j + 1, starts.shape[1]):
                move = motion.end_moves[later - 1, velocity]
                starts[i, later, 0] = starts[i, later - 1, 0] + move[0]
                starts[i, later, 1] = starts[i, later - 1, 1] + move[1]
        left[i, 0], left[i, 1], left[i, 2], left[i, 3], turned = _follow_back(
            positions[i], velocities[i], starts[i], tables, places, scores, segment, y, x,
            velocity, last, stop, motion, layout)
        left[i, 4] = turns + turned


@numba.njit(**EXACT)
def _next_peak(best, at):
    """Return number of the end, y and x of the largest of ``best`` (E, Y, X)."""
    end, y = ZERO, ZERO
    for e in range(best.shape[0]):
        for row in range(best.shape[1]):
            if best[e, row, at[e, row]] > best[end, y, at[end, y]]:
                end, y = e, row
    return end, y, at[end, y]


@numba.njit(**EXACT)
def leave_out(best, at, starts, radius):
    """Leave the surroundings of a path out of ``best`` (E, Y, X) and of the largest of its rows.

    starts : int64 (E, 2), x and y of its starts of the segments in which paths end
    """
    for e in range(best.shape[0]):
        x, y = starts[e]
        for row in range(max(0, y - radius), min(best.shape[1], y + radius + 1)):
            best[e, row, max(0, x - radius):max(0, x + radius + 1)] = ABSENT
            at[e, row] = np.argmax(best[e, row])


@numba.njit(**EXACT)
def pick_peaks(peaks, best, at, above, radius):
    """Write number of the end, y and x of separate peaks, largest first; return how many.

    Their surroundings are left out of ``best`` (E, Y, X).

    at : int64 (E, Y), x of the largest of each row, so that a peak costs the rows around it
    """
    starts = np.full((best.shape[0], 2), NOWHERE)
    for i in range(len(peaks)):
        end, y, x = _next_peak(best, at)
        if not best[end, y, x] > above:
            return i
        peaks[i, 0], peaks[i, 1], peaks[i, 2] = end, y, x
        starts[end, 0], starts[end, 1] = x, y
        leave_out(best, at, starts, radius)
        starts[end, 0] = starts[end, 1] = NOWHERE
    return len(peaks)
