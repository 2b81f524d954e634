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

A position outside the grid has weight ``ABSENT``.

Every value is computed by the same operations in the same order whether a whole table is filled
or a few of its states are computed anew, so both give the same bits.

The loops over x are small functions of their own on purpose: written into the nest above them
they are not vectorised. They take whole arrays, flat, with unsigned offsets: a slice for each row
would cost two atomic updates of a reference count, as long as adding sixty numbers, and a signed
index would be checked for being negative at each step.
"""

import numba
import numpy as np

ABSENT = np.float32(-1e30)

_COMPILE = {'nogil': True, 'cache': True, 'fastmath': {'nnan', 'ninf', 'nsz'}}
_U = np.uint64


@numba.njit(**_COMPILE)
def fill_row(out, o, n, value):
    """Write ``value`` to out[o + x]."""
    for x in range(_U(n)):
        out[o + x] = value


@numba.njit(**_COMPILE)
def copy_row(out, o, source, a, n):
    """Write source[a + x] to out[o + x]."""
    for x in range(_U(n)):
        out[o + x] = source[a + x]


@numba.njit(**_COMPILE)
def _add(out, o, source, a, n):
    for x in range(_U(n)):
        out[o + x] += source[a + x]


@numba.njit(**_COMPILE)
def _add_two(out, o, source, a, b, n):
    for x in range(_U(n)):
        out[o + x] += source[a + x] + source[b + x]


@numba.njit(**_COMPILE)
def _add_three(out, o, source, a, b, c, n):
    for x in range(_U(n)):
        out[o + x] += source[a + x] + source[b + x] + source[c + x]


@numba.njit(**_COMPILE)
def _add_four(out, o, source, a, b, c, d, n):
    for x in range(_U(n)):
        out[o + x] += (source[a + x] + source[b + x]) + (source[c + x] + source[d + x])


@numba.njit(**_COMPILE)
def _turn_and_add_three(out, o, turns, here, left, right, cost, source, a, b, c, n):
    for x in range(_U(n)):
        beside = turns[left + x] if turns[left + x] > turns[right + x] else turns[right + x]
        beside -= cost
        best = turns[here + x] if turns[here + x] > beside else beside
        out[o + x] = best + (source[a + x] + source[b + x] + source[c + x])


@numba.njit(**_COMPILE)
def raise_row(out, o, source, a, n, cost):
    """Raise out[o + x] to source[a + x] - cost where that is more."""
    for x in range(_U(n)):
        other = source[a + x] - cost
        out[o + x] = out[o + x] if out[o + x] > other else other


@numba.njit(**_COMPILE)
def _best_of_three(out, o, source, here, left, right, n, cost):
    for x in range(_U(n)):
        beside = source[left + x] if source[left + x] > source[right + x] else source[right + x]
        beside -= cost
        out[o + x] = source[here + x] if source[here + x] > beside else beside


@numba.njit(**_COMPILE)
def shifted_row(out, o, value, row, y, n_y, n_x, move_x, move_y, start, stop):
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


@numba.njit(**_COMPILE)
def extents_of(moves, first_frame, last_frame, n_y, n_x):
    """Return what adding the scores of a segment needs for each velocity.

    extents[v] : first and last x, first and last y from which all frames stay on the grid
    offsets[v, t] : flat index of the position in frame t less that of the start in frame 0
    """
    n_v = moves.shape[1]
    extents = np.zeros((n_v, 4), np.int64)
    offsets = np.empty((n_v, last_frame - first_frame), np.int64)
    for v in range(n_v):
        extents[v, 1] = n_x
        extents[v, 3] = n_y
        for t in range(first_frame, last_frame):
            extents[v, 0] = max(extents[v, 0], -moves[t, v, 0])
            extents[v, 1] = min(extents[v, 1], n_x - moves[t, v, 0])
            extents[v, 2] = max(extents[v, 2], -moves[t, v, 1])
            extents[v, 3] = min(extents[v, 3], n_y - moves[t, v, 1])
            offsets[v, t - first_frame] = (t * n_y + moves[t, v, 1]) * n_x + moves[t, v, 0]
    return extents, offsets


@numba.njit(**_COMPILE)
def _add_scores(out, o, scores, offsets, v, start, n, t):
    """Add to out[o + x] the weights met in the frames of a segment from its frame ``t`` on.

    ``start`` is the flat index of the first position left from. Several rows at a time: the
    running sum is then loaded and stored once for several frames.
    """
    n_frames = offsets.shape[1]
    while t + 4 <= n_frames:
        _add_four(out, o, scores, _U(start + offsets[v, t]), _U(start + offsets[v, t + 1]),
                  _U(start + offsets[v, t + 2]), _U(start + offsets[v, t + 3]), n)
        t += 4
    if t + 3 == n_frames:
        _add_three(out, o, scores, _U(start + offsets[v, t]), _U(start + offsets[v, t + 1]),
                   _U(start + offsets[v, t + 2]), n)
    elif t + 2 == n_frames:
        _add_two(out, o, scores, _U(start + offsets[v, t]), _U(start + offsets[v, t + 1]), n)
    elif t + 1 == n_frames:
        _add(out, o, scores, _U(start + offsets[v, t]), n)


@numba.njit(**_COMPILE)
def _raise_from_sides(out, o, source, start, stride, here, n_rows, k, n, cost):
    """Raise out[o + x] to the rows k before and k after row ``here`` where there are such."""
    if 0 <= here - k < n_rows:
        raise_row(out, o, source, _U(start + (here - k) * stride), n, np.float32(k) * cost)
    if 0 <= here + k < n_rows:
        raise_row(out, o, source, _U(start + (here + k) * stride), n, np.float32(k) * cost)


@numba.njit(**_COMPILE)
def best_turn_x(turns, o, flat, row, i, n_v, n_x, start, n, reach, cost):
    """Write to turns[o + x] the best within ``reach`` steps of v_x, less ``cost`` a step.

    The cost of a turn is the sum of its steps in v_x and v_y, so the maximum over the square of
    velocities is one over v_x and then one over v_y. Rows of the disc of velocities have different
    lengths: ``i`` counts from the first velocity of the row and may lie outside the row, for a
    longer neighbouring row needs those columns too. The row of velocities starts at flat[row].
    """
    here = row + start
    nearest = 1
    if 1 <= i < n_v - 1:
        _best_of_three(turns, o, flat, _U(here + i * n_x), _U(here + (i - 1) * n_x),
                       _U(here + (i + 1) * n_x), n, cost)
        nearest = 2
    elif 0 <= i < n_v:
        copy_row(turns, o, flat, _U(here + i * n_x), n)
    else:
        fill_row(turns, o, n, ABSENT)
    for k in range(nearest, reach + 1):
        _raise_from_sides(turns, o, flat, here, n_x, i, n_v, k, n, cost)


@numba.njit(**_COMPILE)
def best_turn_y(out, o, turns, column, stride, r, n_rows, n, reach, cost):
    """Write to out[o + x] the best within ``reach`` rows of ``turns``, less ``cost`` a row."""
    nearest = 1
    if 1 <= r < n_rows - 1:
        _best_of_three(out, o, turns, _U(r * stride + column), _U((r - 1) * stride + column),
                       _U((r + 1) * stride + column), n, cost)
        nearest = 2
    else:
        copy_row(out, o, turns, _U(r * stride + column), n)
    for k in range(nearest, reach + 1):
        _raise_from_sides(out, o, turns, column, stride, r, n_rows, k, n, cost)


@numba.njit(**_COMPILE)
def row_width(row_first, row_x):
    """Return the number of columns of the grid of velocities."""
    width = 0
    for r in range(row_x.size):
        width = max(width, row_x[r] + row_first[r + 1] - row_first[r])
    return width


@numba.njit(**_COMPILE)
def extend(flat, o, turns, column, stride, r, n_rows, reach, cost, starting, scores, offsets, v,
            start, n):
    """Write to flat[o + x] the best turn and the weights met in the segment.

    ``column`` is the flat index of the first state in a row of ``turns``, ``start`` that of its
    position in a frame. All frames of the segment stay on the grid.
    """
    done = 0
    if starting:
        fill_row(flat, o, n, np.float32(0))
    elif reach == 1 and 1 <= r < n_rows - 1 and offsets.shape[1] >= 3:
        # The common case in one loop, which spares a pass over the row.
        _turn_and_add_three(
            flat, o, turns, _U(r * stride + column), _U((r - 1) * stride + column),
            _U((r + 1) * stride + column), cost, scores, _U(start + offsets[v, 0]),
            _U(start + offsets[v, 1]), _U(start + offsets[v, 2]), n)
        done = 3
    else:
        best_turn_y(flat, o, turns, column, stride, r, n_rows, n, reach, cost)
    _add_scores(flat, o, scores, offsets, v, start, n, done)


@numba.njit(**_COMPILE)
def forward_segment(value, before, scores, moves, end_moves_before, first_frame, last_frame,
                    row_first, row_x, reach, cost, first_row, last_row):
    """Extend the best paths by one segment, rows ``first_row`` to ``last_row`` of ``value``.

    value[y, v, x] = max over v' near v of (before[p - end_move(v'), v'] - cost * |v - v'|)
                     + sum over frames of scores[t, p + move(t, v)],   p = (y, x)

    ``before`` of no rows starts the paths: the maximum is then zero.
    """
    n_y, n_v, n_x = value.shape
    flat = value.reshape(value.size)
    flat_before = before.reshape(before.size)
    flat_scores = scores.reshape(scores.size)
    starting = before.shape[0] == 0
    width = row_width(row_first, row_x)
    stride = width * n_x
    n_rows = row_x.size
    turns = np.empty(n_rows * stride, np.float32)
    extents, offsets = extents_of(moves, first_frame, last_frame, n_y, n_x)
    for y in range(first_row, last_row):
        block = y * n_v * n_x
        if not starting:
            for v in range(n_v):
                move_x, move_y = -end_moves_before[v, 0], -end_moves_before[v, 1]
                shifted_row(flat, _U(block + v * n_x), flat_before,
                             ((y + move_y) * n_v + v) * n_x, y, n_y, n_x, move_x, move_y, 0, n_x)
            for r in range(n_rows):
                for c in range(width):
                    best_turn_x(turns, _U((r * width + c) * n_x), flat,
                                 block + row_first[r] * n_x, c - row_x[r],
                                 row_first[r + 1] - row_first[r], n_x, 0, n_x, reach, cost)
        for r in range(n_rows):
            for v in range(row_first[r], row_first[r + 1]):
                o = _U(block + v * n_x)
                first, last = extents[v, 0], extents[v, 1]
                if y < extents[v, 2] or y >= extents[v, 3] or last <= first:
                    fill_row(flat, o, n_x, ABSENT)
                    continue
                fill_row(flat, o, first, ABSENT)
                fill_row(flat, o + _U(last), n_x - last, ABSENT)
                column = (row_x[r] + v - row_first[r]) * n_x + first
                extend(flat, o + _U(first), turns, column, stride, r, n_rows, reach, cost,
                        starting, flat_scores, offsets, v, y * n_x + first, last - first)


@numba.njit(**_COMPILE)
def best_by_position(value, out, first_row, last_row):
    """Write the largest weight over all velocities to out[y, x]."""
    _, n_v, n_x = value.shape
    flat = value.reshape(value.size)
    flat_out = out.reshape(out.size)
    for y in range(first_row, last_row):
        copy_row(flat_out, _U(y * n_x), flat, _U(y * n_v * n_x), n_x)
        for v in range(1, n_v):
            raise_row(flat_out, _U(y * n_x), flat, _U((y * n_v + v) * n_x), n_x, np.float32(0))
