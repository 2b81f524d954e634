"""Best path over the state graph of targets that may enter and leave during the batch.

Being present costs ``presence`` a frame, entering after the first frame costs ``entry``, leaving
before the last one ``leaving``. Along a straight segment, with s_t the weight met in frame t,

    reached_t = max(reached_(t-1), -entry) + s_t - presence,

so that a path may begin in any frame, and the largest of reached_t - leaving over all frames is
that of the best path that ends in any.

Layout of every array
---------------------
scores : float32 (T, Y, X)
    Weight of position (y, x) on the position grid in frame t.
value : float32 (Y, V, X)
    Weight of the best path up to and including one segment, by start position of the segment
    and velocity. The velocity axis lies between the two position axes so that one row y of all
    velocities is one contiguous block, which fits the second-level cache.
moves : int32 (T, V, 2)
    Displacement (x, y) in grid steps from the start of the segment to frame t.
end_moves : int32 (J, V, 2)
    Displacement over the whole segment j, that is, to the start of segment j + 1.
row_first, row_x : int32 (R,)
    Velocities lie on a grid and are numbered row by row (a row has one v_y): number of the first
    velocity of the row and grid index of its v_x; ``row_first`` has R + 1 entries.
ends : float32 (Y, X)
    Weight of the best path that ends in the segment, in whatever frame and with whatever
    velocity, by its position at the start of the segment.

A segment need not lie on the grid as a whole: only where the target is present, and at its start.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FINITE
from track_before_detect.kernels.search.viterbi import (
    ABSENT,
    best_of_three,
    copy_row,
    fill_row,
    raise_row,
)

_U = np.uint64


@numba.njit(**FINITE)
def _shifted_row(out, o, value, row, y, n_y, n_x, move_x, move_y, start, stop):
    """Write value[y + move_y, v, x + move_x] to out[o + x], x from ``start`` to ``stop``.

    Positions off the grid are ABSENT.
    ``row`` is the flat index of value[y + move_y, v, 0].
    """
    first = min(max(start, -move_x), stop)
    last = max(min(stop, n_x - move_x), first)
    if y + move_y < 0 or y + move_y >= n_y:
        last = first
    fill_row(out, o + _U(start), first - start, ABSENT)
    copy_row(out, o + _U(first), value, _U(row + first + move_x), last - first)
    fill_row(out, o + _U(last), stop - last, ABSENT)


@numba.njit(**FINITE)
def _raise_from_sides(out, o, source, start, stride, here, n_rows, k, n, cost):
    """Raise out[o + x] to the rows k before and k after row ``here`` where there are such."""
    if 0 <= here - k < n_rows:
        raise_row(out, o, source, _U(start + (here - k) * stride), n, np.float32(k) * cost)
    if 0 <= here + k < n_rows:
        raise_row(out, o, source, _U(start + (here + k) * stride), n, np.float32(k) * cost)


@numba.njit(**FINITE)
def _best_turn_x(turns, o, flat, row, i, n_v, n_x, start, n, reach, cost):
    """Write to turns[o + x] the best within ``reach`` steps of v_x, less ``cost`` a step.

    The cost of a turn is the sum of its steps in v_x and v_y, so the maximum over the square of
    velocities is one over v_x and then one over v_y. Rows of the disc of velocities have different
    lengths: ``i`` counts from the first velocity of the row and may lie outside the row, for a
    longer neighbouring row needs those columns too. The row of velocities starts at flat[row].
    """
    here = row + start
    nearest = 1
    if 1 <= i < n_v - 1:
        best_of_three(turns, o, flat, _U(here + i * n_x), _U(here + (i - 1) * n_x),
                      _U(here + (i + 1) * n_x), n, cost)
        nearest = 2
    elif 0 <= i < n_v:
        copy_row(turns, o, flat, _U(here + i * n_x), n)
    else:
        fill_row(turns, o, n, ABSENT)
    for k in range(nearest, reach + 1):
        _raise_from_sides(turns, o, flat, here, n_x, i, n_v, k, n, cost)


@numba.njit(**FINITE)
def _best_turn_y(out, o, turns, column, stride, r, n_rows, n, reach, cost):
    """Write to out[o + x] the best within ``reach`` rows of ``turns``, less ``cost`` a row."""
    nearest = 1
    if 1 <= r < n_rows - 1:
        best_of_three(out, o, turns, _U(r * stride + column), _U((r - 1) * stride + column),
                      _U((r + 1) * stride + column), n, cost)
        nearest = 2
    else:
        copy_row(out, o, turns, _U(r * stride + column), n)
    for k in range(nearest, reach + 1):
        _raise_from_sides(out, o, turns, column, stride, r, n_rows, k, n, cost)


@numba.njit(**FINITE)
def _row_width(row_first, row_x):
    """Return the number of columns of the grid of velocities."""
    width = 0
    for r in range(row_x.size):
        width = max(width, row_x[r] + row_first[r + 1] - row_first[r])
    return width


@numba.njit(**FINITE)
def _live_on(out, o, ends, e, scores, a, n, presence, entry, leaving):
    for x in range(_U(n)):
        reached = out[o + x] if out[o + x] > -entry else -entry
        reached += scores[a + x] - presence
        out[o + x] = reached
        end = reached - leaving
        ends[e + x] = ends[e + x] if ends[e + x] > end else end


@numba.njit(**FINITE)
def forward_segment(value, ends, before, scores, moves, end_moves_before, first_frame, last_frame,
                    row_first, row_x, reach, cost, presence, entry, leaving, first_row, last_row):
    """Extend the best paths by one segment, rows ``first_row`` to ``last_row``.

    ``before`` of no rows starts the paths: until then nothing was reached, at no cost.
    """
    n_y, n_v, n_x = value.shape
    flat = value.reshape(value.size)
    flat_ends = ends.reshape(ends.size)
    flat_before = before.reshape(before.size)
    flat_scores = scores.reshape(scores.size)
    starting = before.shape[0] == 0
    width = _row_width(row_first, row_x)
    stride = width * n_x
    n_rows = row_x.size
    turns = np.empty(n_rows * stride, np.float32)
    for y in range(first_row, last_row):
        block = y * n_v * n_x
        fill_row(flat_ends, _U(y * n_x), n_x, ABSENT)
        if not starting:
            for v in range(n_v):
                move_x, move_y = -end_moves_before[v, 0], -end_moves_before[v, 1]
                _shifted_row(flat, _U(block + v * n_x), flat_before,
                             ((y + move_y) * n_v + v) * n_x, y, n_y, n_x, move_x, move_y, 0, n_x)
            for r in range(n_rows):
                for c in range(width):
                    _best_turn_x(turns, _U((r * width + c) * n_x), flat,
                                 block + row_first[r] * n_x, c - row_x[r],
                                 row_first[r + 1] - row_first[r], n_x, 0, n_x, reach, cost)
        for r in range(n_rows):
            for v in range(row_first[r], row_first[r + 1]):
                o = _U(block + v * n_x)
                if starting:
                    fill_row(flat, o, n_x, np.float32(0))
                else:
                    column = (row_x[r] + v - row_first[r]) * n_x
                    _best_turn_y(flat, o, turns, column, stride, r, n_rows, n_x, reach, cost)
                for t in range(first_frame, last_frame):
                    row = y + moves[t, v, 1]
                    first = max(0, -moves[t, v, 0])
                    last = min(n_x, n_x - moves[t, v, 0])
                    if row < 0 or row >= n_y or last <= first:
                        fill_row(flat, o, n_x, ABSENT)
                        continue
                    fill_row(flat, o, first, ABSENT)
                    fill_row(flat, o + _U(last), n_x - last, ABSENT)
                    at_end = t == scores.shape[0] - 1
                    _live_on(flat, o + _U(first), flat_ends, _U(y * n_x + first), flat_scores,
                             _U((t * n_y + row) * n_x + first + moves[t, v, 0]), last - first,
                             presence, entry, np.float32(0) if at_end else leaving)
