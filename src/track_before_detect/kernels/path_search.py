"""Best path over the state graph, one segment of straight motion at a time.

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

A position outside the grid has weight ``ABSENT``. The loops over x are small functions of their
own on purpose: inlined in the nest above them they are not vectorised.
"""

import numba
import numpy as np

ABSENT = np.float32(-1e30)

_COMPILE = {'nogil': True, 'cache': True, 'fastmath': {'nnan', 'ninf', 'nsz', 'contract'}}


@numba.njit(**_COMPILE)
def _fill(out, value):
    for x in range(out.size):
        out[x] = value


@numba.njit(**_COMPILE)
def _copy(out, source):
    for x in range(out.size):
        out[x] = source[x]


@numba.njit(**_COMPILE)
def _add(out, source):
    for x in range(out.size):
        out[x] += source[x]


@numba.njit(**_COMPILE)
def _raise_to(out, source, cost):
    for x in range(out.size):
        other = source[x] - cost
        out[x] = out[x] if out[x] > other else other


@numba.njit(**_COMPILE)
def _raise_to_both(out, left, right, cost):
    for x in range(out.size):
        other = (left[x] if left[x] > right[x] else right[x]) - cost
        out[x] = out[x] if out[x] > other else other


@numba.njit(**_COMPILE)
def _largest(row):
    largest = row[0]
    for x in range(row.size):
        largest = row[x] if row[x] > largest else largest
    return largest


@numba.njit(**_COMPILE)
def _shifted_row(out, value, y, v, move_x, move_y):
    """Write value[y + move_y, v, x + move_x] to out[x]; ABSENT off the grid."""
    n_y, _, n_x = value.shape
    y_from = y + move_y
    first = max(0, -move_x)
    last = min(n_x, n_x - move_x)
    if y_from < 0 or y_from >= n_y or last <= first:
        _fill(out, ABSENT)
        return
    _fill(out[:first], ABSENT)
    _copy(out[first:last], value[y_from, v, first + move_x:last + move_x])
    _fill(out[last:], ABSENT)


@numba.njit(**_COMPILE)
def _add_scores(out, scores, moves, v, y, first_frame, last_frame):
    """Add to out[x] the weights met on leaving (y, x) with velocity v."""
    n_y, n_x = scores.shape[1:]
    for t in range(first_frame, last_frame):
        move_x = moves[t, v, 0]
        y_at = y + moves[t, v, 1]
        first = max(0, -move_x)
        last = min(n_x, n_x - move_x)
        if y_at < 0 or y_at >= n_y or last <= first:
            _fill(out, ABSENT)
            return
        if first > 0:
            _fill(out[:first], ABSENT)
        _add(out[first:last], scores[t, y_at, first + move_x:last + move_x])
        if last < n_x:
            _fill(out[last:], ABSENT)


@numba.njit(**_COMPILE)
def _best_turn(out, scratch, row_first, row_x, reach, cost):
    """Raise each velocity's row to the best within ``reach`` steps, less ``cost`` a step.

    The cost is the sum of the steps in v_x and v_y, so the maximum over the square of velocities
    is one over v_x and then one over v_y. Rows of the disc of velocities have different lengths;
    the pass over v_x fills ``scratch`` for the columns that a longer neighbouring row needs too.
    """
    n_rows = row_x.size
    width = scratch.shape[1]
    for r in range(n_rows):
        first = row_first[r]
        n_v = row_first[r + 1] - first
        for c in range(width):
            i = c - row_x[r]
            if 0 <= i < n_v:
                _copy(scratch[r, c], out[first + i])
            else:
                _fill(scratch[r, c], ABSENT)
            for k in range(1, reach + 1):
                left = 0 <= i - k < n_v
                right = 0 <= i + k < n_v
                if left and right:
                    _raise_to_both(scratch[r, c], out[first + i - k], out[first + i + k],
                                   np.float32(k) * cost)
                elif left:
                    _raise_to(scratch[r, c], out[first + i - k], np.float32(k) * cost)
                elif right:
                    _raise_to(scratch[r, c], out[first + i + k], np.float32(k) * cost)
    for r in range(n_rows):
        for v in range(row_first[r], row_first[r + 1]):
            c = row_x[r] + v - row_first[r]
            _copy(out[v], scratch[r, c])
            for k in range(1, reach + 1):
                below = r - k >= 0
                above = r + k < n_rows
                if below and above:
                    _raise_to_both(out[v], scratch[r - k, c], scratch[r + k, c],
                                   np.float32(k) * cost)
                elif below:
                    _raise_to(out[v], scratch[r - k, c], np.float32(k) * cost)
                elif above:
                    _raise_to(out[v], scratch[r + k, c], np.float32(k) * cost)


@numba.njit(**_COMPILE)
def forward_segment(value, before, scores, moves, end_moves_before, first_frame, last_frame,
                    row_first, row_x, reach, cost, first_row, last_row):
    """Extend the best paths by one segment, rows ``first_row`` to ``last_row`` of ``value``.

    value[y, v, x] = max over v' near v of (before[p - end_move(v'), v'] - cost * |v - v'|)
                     + sum over frames of scores[t, p + move(t, v)],   p = (y, x)

    ``before`` of no rows starts the paths: the maximum is then zero.
    """
    _, n_v, n_x = value.shape
    width = 0
    for r in range(row_x.size):
        width = max(width, row_x[r] + row_first[r + 1] - row_first[r])
    scratch = np.empty((row_x.size, width, n_x), np.float32)
    for y in range(first_row, last_row):
        if before.shape[0] == 0:
            _fill(value[y].reshape(n_v * n_x), np.float32(0))
        else:
            for v in range(n_v):
                _shifted_row(value[y, v], before, y, v,
                             -end_moves_before[v, 0], -end_moves_before[v, 1])
            _best_turn(value[y], scratch, row_first, row_x, reach, cost)
        for v in range(n_v):
            _add_scores(value[y, v], scores, moves, v, y, first_frame, last_frame)


@numba.njit(**_COMPILE)
def onward_segment(value, after, scores, moves, end_moves, first_frame, last_frame,
                   row_first, row_x, reach, cost):
    """Weight of the best path from each state at the start of a segment to the last frame.

    value[y, v, x] = max over v' near v of (after[p + end_move(v), v'] - cost * |v - v'|)
                     + sum over frames of scores[t, p + move(t, v)],   p = (y, x)

    ``after`` of no rows ends the paths: the maximum is then zero. ``after`` is overwritten.
    """
    n_y, n_v, n_x = value.shape
    if after.shape[0] == 0:
        _fill(value.reshape(n_y * n_v * n_x), np.float32(0))
    else:
        width = 0
        for r in range(row_x.size):
            width = max(width, row_x[r] + row_first[r + 1] - row_first[r])
        scratch = np.empty((row_x.size, width, n_x), np.float32)
        for y in range(n_y):
            _best_turn(after[y], scratch, row_first, row_x, reach, cost)
        for y in range(n_y):
            for v in range(n_v):
                _shifted_row(value[y, v], after, y, v, end_moves[v, 0], end_moves[v, 1])
    for y in range(n_y):
        for v in range(n_v):
            _add_scores(value[y, v], scores, moves, v, y, first_frame, last_frame)


@numba.njit(**_COMPILE)
def best_by_position(value, out, first_row, last_row):
    """Write the largest weight over all velocities to out[y, x]."""
    for y in range(first_row, last_row):
        _copy(out[y], value[y, 0])
        for v in range(1, value.shape[1]):
            _raise_to(out[y], value[y, v], np.float32(0))
