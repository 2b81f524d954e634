"""Best paths after few scores have changed: only states whose paths meet a change are computed.

A state depends on the scores along its segment and on the states before it, and on nothing else:
a state that meets no change keeps its value, whatever the model of the amplitudes. A state that
meets one is stale until it is computed, and even then its old value is good for something: no
path gains more than the scores have risen in each frame where they rose most. So a stale state
whose old value, plus that rise, passes neither the threshold nor the largest value known is left
as it is. What targets add to the frames only makes the scores fall once it is taken off, so most
states near a target stay stale for good (safe screening, with a bound for any sign).

Layout of every array
---------------------
As in the module ``path_search``, and

marks, stale, wanted : uint64 (..., Y) or (..., Y, V)
    One bit for each block of ``block`` positions of a row, so that one number covers the row.
"""

import numba
import numpy as np

from track_before_detect.kernels.path_search import (
    ABSENT,
    best_turn_x,
    copy_row,
    extend,
    extents_of,
    raise_row,
    row_width,
    shifted_row,
)

_COMPILE = {'nogil': True, 'cache': True}
_U = np.uint64
BLOCKS = 64


@numba.njit(**_COMPILE)
def _shifted_blocks(marks, step, block):
    """Return the blocks from which some position meets a marked block after ``step``."""
    whole = step // block
    met = _moved_bits(marks, whole)
    return met if step == whole * block else met | _moved_bits(marks, whole + 1)


@numba.njit(**_COMPILE)
def _moved_bits(marks, n):
    if n >= BLOCKS or n <= -BLOCKS:
        return _U(0)
    return marks >> _U(n) if n >= 0 else marks << _U(-n)


@numba.njit(**_COMPILE)
def _run(marks, b):
    """Return the first run of marked blocks from block ``b`` on: first, and one past the last."""
    if b >= BLOCKS or not marks >> _U(b):
        return BLOCKS, BLOCKS
    while not marks >> _U(b) & _U(1):
        b += 1
    end = b
    while end < BLOCKS and marks >> _U(end) & _U(1):
        end += 1
    return b, end


@numba.njit(**_COMPILE)
def _differ(new, old, o, n):
    bits = np.int32(0)
    for x in range(_U(n)):
        bits |= new[o + x] ^ old[o + x]
    return bits != 0


@numba.njit(**_COMPILE)
def changed_scores(marks, rise, new, old, new_bits, old_bits, block, first_row, last_row):
    """Find the blocks in which the scores (T, Y, X) differ, and how much they rise.

    marks[t, y] : the blocks
    rise[y, t] : largest rise in the row, not below zero
    new_bits, old_bits : the scores, seen as int32
    """
    n_frames, n_y, n_x = new.shape
    flat_new, flat_old = new.reshape(new.size), old.reshape(old.size)
    flat_new_bits, flat_old_bits = new_bits.reshape(new.size), old_bits.reshape(old.size)
    for t in range(n_frames):
        for y in range(first_row, last_row):
            marks[t, y] = 0
            rise[y, t] = 0
            row = (t * n_y + y) * n_x
            if not _differ(flat_new_bits, flat_old_bits, _U(row), n_x):
                continue
            for b in range((n_x + block - 1) // block):
                start = row + b * block
                n = min(block, n_x - b * block)
                if _differ(flat_new_bits, flat_old_bits, _U(start), n):
                    marks[t, y] |= _U(1) << _U(b)
                    for x in range(start, start + n):
                        rise[y, t] = max(rise[y, t], flat_new[x] - flat_old[x])


@numba.njit(**_COMPILE)
def _spread(out, marks, row_first, row_x, reach, width, columns):
    """Write to out[v] all that is marked for a velocity within ``reach`` of v, for one row."""
    n_rows = row_x.size
    for r in range(n_rows):
        n_v = row_first[r + 1] - row_first[r]
        for c in range(width):
            i = c - row_x[r]
            columns[r, c] = 0
            for k in range(max(0, i - reach), min(n_v, i + reach + 1)):
                columns[r, c] |= marks[row_first[r] + k]
    for r in range(n_rows):
        for v in range(row_first[r], row_first[r + 1]):
            c = row_x[r] + v - row_first[r]
            out[v] = 0
            for k in range(max(0, r - reach), min(n_rows, r + reach + 1)):
                out[v] |= columns[k, c]


@numba.njit(**_COMPILE)
def changed_states(marks, marks_before, score_marks, moves, end_moves_before, first_frame,
                   last_frame, row_first, row_x, reach, block, n_x, first_row, last_row):
    """Add to marks[y, v] the states of a segment that meet a change.

    ``marks_before`` of the segment before, of no rows for the first segment.
    """
    n_y, n_v = marks.shape
    met_before = np.zeros(n_v, np.uint64)
    width = row_width(row_first, row_x)
    columns = np.empty((row_x.size, width), np.uint64)
    arriving = np.zeros(n_v, np.uint64)
    n_blocks = (n_x + block - 1) // block
    all_blocks = ~_U(0) >> _U(BLOCKS - n_blocks)
    for y in range(first_row, last_row):
        if marks_before.shape[0] > 0:
            for v in range(n_v):
                row = y - end_moves_before[v, 1]
                arriving[v] = _U(0)
                if 0 <= row < n_y and marks_before[row, v]:
                    arriving[v] = _shifted_blocks(marks_before[row, v], -end_moves_before[v, 0],
                                                  block)
            _spread(met_before, arriving, row_first, row_x, reach, width, columns)
        for v in range(n_v):
            met = met_before[v]
            for t in range(first_frame, last_frame):
                row = y + moves[t, v, 1]
                if 0 <= row < n_y and score_marks[t, row]:
                    met |= _shifted_blocks(score_marks[t, row], moves[t, v, 0], block)
            marks[y, v] |= met & all_blocks


@numba.njit(**_COMPILE)
def spread_turns(near, wanted, row_first, row_x, reach, first_row, last_row):
    """Write to near[y, v] all that is wanted for a velocity within ``reach`` of v."""
    columns = np.empty((row_x.size, row_width(row_first, row_x)), np.uint64)
    for y in range(first_row, last_row):
        _spread(near[y], wanted[y], row_first, row_x, reach, columns.shape[1], columns)


@numba.njit(**_COMPILE)
def wanted_before(wanted, stale, near, end_moves, block, first_row, last_row):
    """Write to wanted[y, v] the stale states of a segment that wanted ones follow.

    ``near`` is what ``spread_turns`` makes of the states wanted in the segment after.
    """
    n_y, n_v = stale.shape
    for y in range(first_row, last_row):
        for v in range(n_v):
            row = y + end_moves[v, 1]
            wanted[y, v] = _U(0)
            if stale[y, v] and 0 <= row < n_y and near[row, v]:
                wanted[y, v] = stale[y, v] & _shifted_blocks(near[row, v], end_moves[v, 0], block)


@numba.njit(**_COMPILE)
def _any_velocity(marks):
    met = _U(0)
    for v in range(marks.size):
        met |= marks[v]
    return met


@numba.njit(**_COMPILE)
def raise_stale(best, stale, rise, block, first_row, last_row):
    """Add ``rise`` to the weights of stale blocks, which makes them bounds."""
    n_x = best.shape[1]
    for y in range(first_row, last_row):
        b, end = _run(_any_velocity(stale[y]), 0)
        while b < BLOCKS:
            for x in range(b * block, min(end * block, n_x)):
                best[y, x] += rise
            b, end = _run(_any_velocity(stale[y]), end)


@numba.njit(**_COMPILE)
def wanted_last(wanted, stale, best, level, block, first_row, last_row):
    """Write to wanted[y, v] the stale states of the last segment in blocks above ``level``."""
    n_x = best.shape[1]
    for y in range(first_row, last_row):
        left = _any_velocity(stale[y])
        above = _U(0)
        b, _ = _run(left, 0)
        while b < BLOCKS:
            for x in range(b * block, min((b + 1) * block, n_x)):
                if best[y, x] > level:
                    above |= _U(1) << _U(b)
                    break
            b, _ = _run(left, b + 1)
        for v in range(stale.shape[1]):
            wanted[y, v] = stale[y, v] & above


@numba.njit(**_COMPILE)
def largest_known(best, stale, block):
    """Return the largest weight in blocks that are not stale, and the largest bound in others."""
    n_y, n_x = best.shape
    known, bound = np.float32(ABSENT), np.float32(ABSENT)
    for y in range(n_y):
        left = _any_velocity(stale[y])
        for b in range((n_x + block - 1) // block):
            top = np.float32(ABSENT)
            for x in range(b * block, min((b + 1) * block, n_x)):
                top = max(top, best[y, x])
            if left >> _U(b) & _U(1):
                bound = max(bound, top)
            else:
                known = max(known, top)
    return known, bound


@numba.njit(**_COMPILE)
def count_blocks(marks):
    """Return the number of marked blocks."""
    total = 0
    for y in range(marks.shape[0]):
        for v in range(marks.shape[1]):
            left = marks[y, v]
            while left:
                left &= left - _U(1)
                total += 1
    return total


@numba.njit(**_COMPILE)
def update_segment(value, before, scores, moves, end_moves_before, first_frame, last_frame,
                   row_first, row_x, reach, cost, marks, block, first_row, last_row):
    """Compute the marked states of a segment anew, as ``forward_segment`` computes them all."""
    n_y, n_v, n_x = value.shape
    flat = value.reshape(value.size)
    flat_before = before.reshape(before.size)
    flat_scores = scores.reshape(scores.size)
    starting = before.shape[0] == 0
    width = row_width(row_first, row_x)
    stride = width * n_x
    n_rows = row_x.size
    shifted = np.empty(0 if starting else n_v * n_x, np.float32)
    turns = np.empty(0 if starting else n_rows * stride, np.float32)
    columns = np.empty((n_rows, width), np.uint64)
    near = np.zeros(n_v, np.uint64)
    extents, offsets = extents_of(moves, first_frame, last_frame, n_y, n_x)
    for y in range(first_row, last_row):
        if not marks[y].any():
            continue
        if not starting:
            _spread(near, marks[y], row_first, row_x, reach, width, columns)
            for v in range(n_v):
                move_x, move_y = -end_moves_before[v, 0], -end_moves_before[v, 1]
                b, end = _run(near[v], 0)
                while b < BLOCKS:
                    shifted_row(shifted, _U(v * n_x), flat_before,
                                ((y + move_y) * n_v + v) * n_x, y, n_y, n_x, move_x, move_y,
                                b * block, min(end * block, n_x))
                    b, end = _run(near[v], end)
            _turn_columns(columns, marks[y], row_first, row_x, reach, width)
            for r in range(n_rows):
                for c in range(width):
                    b, end = _run(columns[r, c], 0)
                    while b < BLOCKS:
                        start = b * block
                        best_turn_x(turns, _U((r * width + c) * n_x + start), shifted,
                                    row_first[r] * n_x, c - row_x[r],
                                    row_first[r + 1] - row_first[r], n_x, start,
                                    min(end * block, n_x) - start, reach, cost)
                        b, end = _run(columns[r, c], end)
        for r in range(n_rows):
            for v in range(row_first[r], row_first[r + 1]):
                if y < extents[v, 2] or y >= extents[v, 3]:
                    continue
                b, end = _run(marks[y, v], 0)
                while b < BLOCKS:
                    first = max(b * block, extents[v, 0])
                    last = min(end * block, extents[v, 1])
                    if last > first:
                        column = (row_x[r] + v - row_first[r]) * n_x + first
                        extend(flat, _U((y * n_v + v) * n_x + first), turns, column, stride, r,
                               n_rows, reach, cost, starting, flat_scores, offsets, v,
                               y * n_x + first, last - first)
                    b, end = _run(marks[y, v], end)


@numba.njit(**_COMPILE)
def _turn_columns(columns, marks, row_first, row_x, reach, width):
    """Write to columns[r, c] where the best turn in v_x is needed, in a row of positions."""
    n_rows = row_x.size
    columns[:] = 0
    for r in range(n_rows):
        for v in range(row_first[r], row_first[r + 1]):
            if marks[v]:
                c = row_x[r] + v - row_first[r]
                for k in range(max(0, r - reach), min(n_rows, r + reach + 1)):
                    columns[k, c] |= marks[v]


@numba.njit(**_COMPILE)
def update_best(best, value, marks, block, first_row, last_row):
    """Compute the largest weight over all velocities anew where some velocity is marked."""
    _, n_v, n_x = value.shape
    flat = value.reshape(value.size)
    flat_best = best.reshape(best.size)
    for y in range(first_row, last_row):
        any_marked = _any_velocity(marks[y])
        b, end = _run(any_marked, 0)
        while b < BLOCKS:
            start = b * block
            n = min(end * block, n_x) - start
            o = _U(y * n_x + start)
            copy_row(flat_best, o, flat, _U(y * n_v * n_x + start), n)
            for v in range(1, n_v):
                raise_row(flat_best, o, flat, _U((y * n_v + v) * n_x + start), n, np.float32(0))
            b, end = _run(any_marked, end)
