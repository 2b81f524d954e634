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
As in the module ``viterbi``, and

marks, stale, wanted : uint64 (Y, V), or (Y,) for the best of paths that end in a segment
    One bit for each block of ``block`` positions of a row, so that one number covers the row.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FINITE
from track_before_detect.kernels.rows import ABSENT
from track_before_detect.kernels.search.viterbi import BLOCKS, run_of_blocks

_U = np.uint64


@numba.njit(**FINITE)
def _shifted_blocks(marks, step, block):
    """Return the blocks from which some position meets a marked block after ``step``."""
    whole = step // block
    met = _moved_bits(marks, whole)
    return met if step == whole * block else met | _moved_bits(marks, whole + 1)


@numba.njit(**FINITE)
def _moved_bits(marks, n):
    if n >= BLOCKS or n <= -BLOCKS:
        return _U(0)
    return marks >> _U(n) if n >= 0 else marks << _U(-n)


@numba.njit(**FINITE)
def _differ(new, a, old, b, n, price):
    differ = np.int32(0)
    for x in range(_U(n)):
        differ |= np.int32(new[a + x] - price != old[b + x])
    return differ != 0


@numba.njit(**FINITE)
def _largest_rise(new, a, old, b, n, price):
    rise = np.float32(0)
    for x in range(_U(n)):
        change = new[a + x] - price - old[b + x]
        rise = rise if rise > change else change
    return rise


@numba.njit(**FINITE)
def _copy_and_size(out, o, source, a, n, price):
    """Write source[a + x] to out[o + x]; return the largest size of those that are not absent."""
    largest = np.float32(0)
    for x in range(_U(n)):
        score = source[a + x] - price
        out[o + x] = score
        size = abs(score) if score > ABSENT else np.float32(0)
        largest = largest if largest > size else size
    return largest


@numba.njit(**FINITE)
def replace_scores(scores, marks, rise, largest, new, price, rows, layout, first_row, last_row):
    """Bring the scores up to date, and find where they differ and how much they rise.

    marks : uint64 (T, Y), blocks that differ
    rise : float32 (Y, T), largest rise in the row, not below zero
    largest : float32 (Y, T), raised to the largest size of a new score in the row
    new : float32 (T, Y, X), of which ``price`` is taken off
    rows : bool (T, Y), false where nothing differs
    """
    flat = new.reshape(new.size)
    for t in range(new.shape[0]):
        for y in range(first_row, last_row):
            marks[t, y] = 0
            rise[y, t] = 0
            if not rows[t, y]:
                continue
            row = (t * layout.n_y + y) * layout.n_x
            kept = layout.pad + (t * layout.n_y + y) * layout.stride
            if not _differ(flat, _U(row), scores, _U(kept), layout.n_x, price):
                continue
            for start in range(0, layout.n_x, layout.block):
                n = min(layout.block, layout.n_x - start)
                o, a = _U(kept + start), _U(row + start)
                if _differ(flat, a, scores, o, n, price):
                    marks[t, y] |= _U(1) << _U(start // layout.block)
                    rise[y, t] = max(rise[y, t], _largest_rise(flat, a, scores, o, n, price))
                    largest[y, t] = max(largest[y, t],
                                        _copy_and_size(scores, o, flat, a, n, price))


@numba.njit(**FINITE)
def _copy_and_raise_sizes(out, o, source, a, sizes, n, price):
    for x in range(_U(n)):
        score = source[a + x] - price
        out[o + x] = score
        size = abs(score) if score > ABSENT else np.float32(0)
        sizes[x] = sizes[x] if sizes[x] > size else size


@numba.njit(**FINITE)
def store_scores(scores, largest, new, price, layout, first_row, last_row):
    """Copy scores (T, Y, X) less a ``price``, and find how large they are.

    largest : float32 (Y, T), the largest size in frame t in one of these rows, zero in the others
    """
    flat = new.reshape(new.size)
    sizes = np.empty(layout.n_x, np.float32)
    for t in range(new.shape[0]):
        sizes[:] = 0
        for y in range(first_row, last_row):
            row = t * layout.n_y + y
            _copy_and_raise_sizes(scores, _U(layout.pad + row * layout.stride), flat,
                                  _U(row * layout.n_x), sizes, layout.n_x, price)
            largest[y, t] = 0
        for size in sizes:
            largest[first_row, t] = max(largest[first_row, t], size)


@numba.njit(**FINITE)
def _spread(out, marks, slots, columns, reach, beside):
    """Write to out[v] all that is marked for a velocity within reach of v, for one row.

    beside : uint64 (S,), work space on the grid of velocities
    """
    out[:] = 0
    if not marks.any():
        return
    beside[:] = 0
    for v in range(slots.size):
        if marks[v]:
            for k in range(-reach, reach + 1):
                beside[slots[v] + k] |= marks[v]
    for v in range(slots.size):
        for k in range(-reach, reach + 1):
            out[v] |= beside[slots[v] + k * columns]


@numba.njit(**FINITE)
def changed_states(marks, marks_before, score_marks, moves, segment, layout, first_row, last_row):
    """Add to marks[y, v] the states of a segment that meet a change.

    marks_before : of the segment before, of no rows for the first segment
    score_marks : uint64 (K, Y), blocks of scores that differ, in the frames of the segment
    moves : int32 (K, V, 2), displacement from the start of the segment
    """
    n_y, n_v = marks.shape
    met_before = np.zeros(n_v, np.uint64)
    arrival, turns = segment.arrival, segment.turns
    beside = np.empty(turns.velocity_at.size, np.uint64)
    slots = turns.slots
    arriving = np.zeros(n_v, np.uint64)
    n_blocks = (layout.lanes + layout.block - 1) // layout.block
    all_blocks = ~_U(0) >> _U(BLOCKS - n_blocks)
    for y in range(first_row, last_row):
        if marks_before.shape[0] > 0:
            for v in range(n_v):
                row = y - arrival[v, 1]
                arriving[v] = _U(0)
                if 0 <= row < n_y and marks_before[row, v]:
                    arriving[v] = _shifted_blocks(marks_before[row, v], -arrival[v, 0],
                                                  layout.block)
            _spread(met_before, arriving, slots, turns.columns, turns.reach, beside)
        for v in range(n_v):
            met = met_before[v]
            for t in range(moves.shape[0]):
                row = y + moves[t, v, 1]
                if 0 <= row < n_y and score_marks[t, row]:
                    met |= _shifted_blocks(score_marks[t, row], np.int64(moves[t, v, 0]),
                                           layout.block)
            marks[y, v] |= met & all_blocks


@numba.njit(**FINITE)
def spread_turns(near, wanted, segment, first_row, last_row):
    """Write to near[y, v] all that is wanted for a velocity within reach of v."""
    slots, velocity_at, columns, reach, _ = segment.turns
    beside = np.empty(velocity_at.size, np.uint64)
    for y in range(first_row, last_row):
        _spread(near[y], wanted[y], slots, columns, reach, beside)


@numba.njit(**FINITE)
def wanted_before(wanted, stale, near, arrival, layout, first_row, last_row):
    """Add to wanted[y, v] the stale states of a segment that wanted ones follow.

    near : what ``spread_turns`` makes of the states wanted in the segment after
    arrival : int64 (V, 2), displacement over the segment
    """
    n_y, n_v = stale.shape
    for y in range(first_row, last_row):
        for v in range(n_v):
            row = y + arrival[v, 1]
            if stale[y, v] and 0 <= row < n_y and near[row, v]:
                wanted[y, v] |= stale[y, v] & _shifted_blocks(near[row, v], arrival[v, 0],
                                                              layout.block)


@numba.njit(**FINITE)
def raise_stale(best, stale, rise, layout, first_row, last_row):
    """Add ``rise`` to the weights of stale blocks, which makes them bounds."""
    for y in range(first_row, last_row):
        b, end = run_of_blocks(stale[y], 0, BLOCKS)
        while b < BLOCKS:
            for x in range(b * layout.block, min(end * layout.block, layout.n_x)):
                best[y, x] += rise
            b, end = run_of_blocks(stale[y], end, BLOCKS)


@numba.njit(**FINITE)
def wanted_ends(wanted, stale, best, level, layout, first_row, last_row):
    """Write to wanted[y] the stale blocks of ``best`` with a bound above ``level``."""
    for y in range(first_row, last_row):
        wanted[y] = _U(0)
        b, _ = run_of_blocks(stale[y], 0, BLOCKS)
        while b < BLOCKS:
            for x in range(b * layout.block, min((b + 1) * layout.block, layout.n_x)):
                if best[y, x] > level:
                    wanted[y] |= _U(1) << _U(b)
                    break
            b, _ = run_of_blocks(stale[y], b + 1, BLOCKS)


@numba.njit(**FINITE)
def largest_by_row(known, bound, best, stale, layout, first_row, last_row):
    """Find the largest weight of each row in blocks that are not stale, and in those that are."""
    for y in range(first_row, last_row):
        known[y] = bound[y] = ABSENT
        for start in range(0, layout.n_x, layout.block):
            top = ABSENT
            for x in range(start, min(start + layout.block, layout.n_x)):
                top = max(top, best[y, x])
            if stale[y] >> _U(start // layout.block) & _U(1):
                bound[y] = max(bound[y], top)
            else:
                known[y] = max(known[y], top)


@numba.njit(**FINITE)
def count_blocks(marks):
    """Return the number of marked blocks, of flat ``marks``."""
    total = 0
    for word in marks:
        left = word
        while left:
            left &= left - _U(1)
            total += 1
    return total
