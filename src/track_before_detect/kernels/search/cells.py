"""Bounds of the weights of paths, from cells of two by two positions.

A path of the grid is, cell by cell, a path of cells. In each frame a cell stands for the largest
weight that any of its four positions meets there, so a path of cells weighs at least as much as
each path of the grid inside of it. A velocity that moves positions by an odd number of steps takes
those of one cell into two: the best of both is what arrives. So a table of cells, of a quarter of
the states, bounds all paths; those that may pass a level are then searched among positions.

Layout of every array
---------------------
As in the module ``viterbi``, with cells in place of positions: cell i holds the positions 2i and
2i + 1. Moves by m positions are moves by ceil(m / 2) cells.

pooled : float32, flat; row y of frame t of kind f starts at pad + ((f T + t) n_y + y) stride
    Largest weight among the two by two positions from (2y - f // 2, 2x - f % 2) on: where a cell
    is after an even or an odd number of steps along y and x.
odd : bool (V, 2)
    Whether a segment moves x and y by an odd number of positions.
rest : float32 (Y, V, lanes), flat, and alive : uint64 (Y, V)
    Weight of the best that may follow a state, and the blocks where that is known. All else of
    ``rest`` is never read.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FINITE
from track_before_detect.kernels.rows import (
    ABSENT,
    add_row,
    copy_row,
    fill_row,
    larger_of_two,
    raise_row,
)
from track_before_detect.kernels.search.borrowed_arrays import borrowed
from track_before_detect.kernels.search.viterbi import BLOCKS, extend_paths, run_of_blocks

_U = np.uint64


@numba.njit(**FINITE)
def _pool_columns(out, o, row, a, n):
    """Write the larger of two neighbours to out[o + x], pair by pair."""
    for x in range(_U(n)):
        one, other = row[a + _U(2) * x], row[a + _U(2) * x + _U(1)]
        out[o + x] = one if one > other else other


@numba.njit(**FINITE)
def pool_scores(pooled, scores, price, layout, first_row, last_row):
    """Write what cells meet in rows ``first_row`` to ``last_row``.

    scores : float32 (T, Y, X), of positions, of which ``price`` is taken off
    """
    n_frames, n_y, n_x = scores.shape
    pooled, flat = borrowed(pooled), borrowed(scores.reshape(scores.size))
    row = np.full(2 * layout.n_x + 2, ABSENT)
    for t in range(n_frames):
        for y in range(first_row, last_row):
            for odd_y in range(2):
                fill_row(row, _U(0), row.size, ABSENT)
                for k in range(2 * y - odd_y, 2 * y - odd_y + 2):
                    if 0 <= k < n_y:
                        raise_row(row, _U(1), flat, _U((t * n_y + k) * n_x), n_x, price)
                for odd_x in range(2):
                    frame = (2 * odd_y + odd_x) * n_frames + t
                    _pool_columns(pooled, _U(layout.pad + (frame * layout.n_y + y)
                                             * layout.stride), row, _U(1 - odd_x), layout.n_x)


@numba.njit(**FINITE)
def _largest_of_four(out, o, source, a, b, n):
    """Write the largest of two neighbours in each of two rows to out[o + x]."""
    for x in range(_U(n)):
        one = source[a + x] if source[a + x] > source[b + x] else source[b + x]
        other = (source[a + x + _U(1)] if source[a + x + _U(1)] > source[b + x + _U(1)]
                 else source[b + x + _U(1)])
        out[o + x] = one if one > other else other


@numba.njit(**FINITE)
def extend_cells(value, best, before, scores, segment, layout, arrival, odd, places, marks,
                 finished, first_row, last_row):
    """Extend the best paths of cells by one segment; see ``viterbi.extend_paths``.

    segment : Segment
        As if nothing had moved in the segment before, whose states lie where this writes, row by
        row, what arrives.
    arrival, odd : of the segment before
    places : int64 (Y, V), where its states lie
    """
    if before.size == 0:
        extend_paths(value, best, before, scores, segment, layout, None, marks, finished,
                     first_row, last_row)
        return
    n_y, n_v, lanes = layout.n_y, layout.n_v, layout.lanes
    before, places, arrived = borrowed(before), borrowed(places), segment.places_before
    arriving = np.full(layout.guard + n_v * layout.stride, ABSENT)
    for y in range(first_row, last_row):
        for v in range(n_v):
            o, row, x = _U(arrived[y, v]), y - arrival[v, 1], arrival[v, 0]
            here, beside = 0 <= row < n_y, odd[v, 1] and 0 <= row + 1 < n_y
            if not here and not beside:
                fill_row(arriving, o, lanes, ABSENT)
                continue
            a = _U(places[row if here else row + 1, v] - x)
            b = _U(places[row + 1 if beside else row, v] - x)
            if odd[v, 0] and here and beside:
                _largest_of_four(arriving, o, before, a, b, lanes)
            elif odd[v, 0]:
                larger_of_two(arriving, o, before, a, a + _U(1), lanes)
            elif here and beside:
                larger_of_two(arriving, o, before, a, b, lanes)
            else:
                copy_row(arriving, o, before, a, lanes)
        extend_paths(value, best, arriving, scores, segment, layout, None, marks, finished, y,
                     y + 1)


@numba.njit(**FINITE)
def _blocks_above(best, y, level, block, n_x, per_cell):
    """Return the blocks of ``per_cell`` places a cell, up to n_x, with cells above a level."""
    blocks = _U(0)
    for x in range((n_x + per_cell - 1) // per_cell):
        if best[y, x] >= level:
            blocks |= _U(1) << _U(per_cell * x // block)
    return blocks


@numba.njit(**FINITE)
def mark_ends(marks, best, level, of_positions):
    """Mark the positions of cells where paths end that weigh ``level`` or more; count blocks.

    With all velocities, as the largest weight of a position needs them.

    marks : uint64 (Y, V), of positions, laid out as ``of_positions`` says
    best : float32 (Y, X), of cells
    """
    n_marked = 0
    for row in range(of_positions.n_y):
        blocks = _blocks_above(best, row // 2, level, of_positions.block, of_positions.n_x, 2)
        for v in range(of_positions.n_v):
            marks[row, v] = blocks
        while blocks:
            blocks &= blocks - _U(1)
            n_marked += of_positions.n_v
    return n_marked


@numba.njit(**FINITE)
def _any_above(value, a, n, level):
    above = np.int32(0)
    for x in range(_U(n)):
        above |= np.int32(value[a + x] >= level)
    return above != 0


@numba.njit(**FINITE)
def _any_passes(value, a, rest, o, n, level):
    """Make ``rest`` absent where no path passes a level; return whether any does."""
    passes = np.int32(0)
    for x in range(_U(n)):
        above = value[a + x] + rest[o + x] >= level
        rest[o + x] = rest[o + x] if above else ABSENT
        passes |= np.int32(above)
    return passes != 0


@numba.njit(**FINITE)
def _keep_passing(rest, alive, value, places, level, layout):
    """Leave alive what is on a path that weighs ``level`` or more."""
    n_v, lanes, block = layout.n_v, layout.lanes, layout.block
    for y in range(layout.n_y):
        for v in range(n_v):
            b, end = run_of_blocks(alive[y, v], 0, BLOCKS)
            while b < BLOCKS:
                for k in range(b, end):
                    if not _any_passes(value, _U(places[y, v] + k * block), rest,
                                       _U((y * n_v + v) * lanes + k * block), block, level):
                        alive[y, v] &= ~(_U(1) << _U(k))
                b, end = run_of_blocks(alive[y, v], end, BLOCKS)


@numba.njit(**FINITE)
def begin_rest(rest, alive, best, value, places, level, layout):
    """Find the states of the last segment that paths of a weight of ``level`` or more end in.

    rest, alive : receive that nothing follows them; none alive yet
    """
    rest, value = borrowed(rest), borrowed(value)
    for y in range(layout.n_y):
        blocks = _blocks_above(best, y, level, layout.block, layout.n_x, 1)
        for v in range(layout.n_v):
            left = blocks
            while left:
                b, _ = run_of_blocks(left, 0, BLOCKS)
                left &= left - _U(1)
                start = b * layout.block
                # Few of them are: read before anything is written.
                if _any_above(value, _U(places[y, v] + start), layout.block, level):
                    alive[y, v] |= _U(1) << _U(b)
                    fill_row(rest, _U((y * layout.n_v + v) * layout.lanes + start), layout.block,
                             np.float32(0))
    _keep_passing(rest, alive, value, places, level, layout)


@numba.njit(**FINITE)
def _meet_frames(rest, alive, scores, segment, layout):
    """Add to what follows a segment what is met in it; paths that leave the grid are none."""
    n_y, _, n_v, stride, lanes, block, pad, _ = layout
    offsets, first_y, last_y = borrowed(segment.offsets), segment.first_y, segment.last_y
    for y in range(n_y):
        for v in range(n_v):
            if not first_y[v] <= y < last_y[v]:
                alive[y, v] = 0
            b, end = run_of_blocks(alive[y, v], 0, BLOCKS)
            while b < BLOCKS:
                start = b * block
                for t in range(offsets.shape[1]):
                    add_row(rest, _U((y * n_v + v) * lanes + start), scores,
                            _U(pad + y * stride + start + offsets[v, t]), (end - b) * block)
                b, end = run_of_blocks(alive[y, v], end, BLOCKS)


@numba.njit(**FINITE)
def _raise_blocks(rest, alive, o, start, n, source, a, cost, block):
    """Raise rest[o + x] from x = start on, in blocks that nothing was known of before as well."""
    blocks = alive
    for b in range(start // block, (start + n - 1) // block + 1):
        if not blocks >> _U(b) & _U(1):
            fill_row(rest, _U(o + b * block), block, ABSENT)
            blocks |= _U(1) << _U(b)
    raise_row(rest, _U(o + start), source, _U(a), n, cost)
    return blocks


@numba.njit(**FINITE)
def _spread_back(before, alive_before, rest, alive, arrival, odd, turns, layout):
    """Write what may follow the states of the segment before."""
    n_y, n_x, n_v, _, lanes, block, _, _ = layout
    slots, velocity_at, columns, reach, cost = turns
    for y in range(n_y):
        for v in range(n_v):
            b, end = run_of_blocks(alive[y, v], 0, BLOCKS)
            while b < BLOCKS:
                for k in range(-reach, reach + 1):
                    for m in range(-reach, reach + 1):
                        u = velocity_at[slots[v] + k * columns + m]
                        if u == n_v:
                            continue
                        price = np.float32(abs(k) + abs(m)) * cost
                        for row in range(y - arrival[u, 1], y - arrival[u, 1] + 1 + odd[u, 1]):
                            if not 0 <= row < n_y:
                                continue
                            for step in range(-arrival[u, 0], -arrival[u, 0] + 1 + odd[u, 0]):
                                start = max(0, b * block + step)
                                n = min(end * block + step, n_x) - start
                                if n > 0:
                                    alive_before[row, u] = _raise_blocks(
                                        before, alive_before[row, u], (row * n_v + u) * lanes,
                                        start, n, rest,
                                        (y * n_v + v) * lanes + start - step, price, block)
                b, end = run_of_blocks(alive[y, v], end, BLOCKS)


@numba.njit(**FINITE)
def rest_before(before, alive_before, rest, alive, value, scores, segment, layout, arrival, odd,
                places, level):
    """Find which states of the segment before are on a path that may pass a level.

    before, alive_before : of the segment before; none alive yet
    rest, alive : of what follows ``segment``; its own frames are added
    value, arrival, odd, places : of the segment before
    """
    before, rest = borrowed(before), borrowed(rest)
    value, scores = borrowed(value), borrowed(scores)
    _meet_frames(rest, alive, scores, segment, layout)
    _spread_back(before, alive_before, rest, alive, arrival, odd, segment.turns, layout)
    _keep_passing(before, alive_before, value, places, level, layout)


@numba.njit(**FINITE)
def mark_positions(marks, rest, alive, layout, of_positions):
    """Mark the positions in the cells that are alive; return the number of their blocks.

    marks : uint64 (Y, V), of positions, laid out as ``of_positions`` says
    """
    n_marked = 0
    for y in range(layout.n_y):
        for v in range(layout.n_v):
            blocks = _U(0)
            b, end = run_of_blocks(alive[y, v], 0, BLOCKS)
            while b < BLOCKS:
                for x in range(b * layout.block,
                               min(end * layout.block, (of_positions.n_x + 1) // 2)):
                    if rest[(y * layout.n_v + v) * layout.lanes + x] > np.float32(0.5) * ABSENT:
                        blocks |= _U(1) << _U(2 * x // of_positions.block)
                b, end = run_of_blocks(alive[y, v], end, BLOCKS)
            for row in range(2 * y, min(2 * y + 2, of_positions.n_y)):
                marks[row, v] = blocks
            while blocks:
                blocks &= blocks - _U(1)
                n_marked += 2
    return n_marked


@numba.njit(**FINITE)
def place_marked(places, marks, marks_after, arrival, turns, layout, begin):
    """Give marked states places in a table, from ``begin`` on; return where the next may lie.

    A row is given the room for all that is read of it: what is marked, and what the marked states
    of the segment after may have come by.

    places : int64 (Y, V), zero
    marks_after, arrival : of the segment after, and what moves states there
    """
    n_y, _, n_v, _, lanes, block, _, _ = layout
    slots, velocity_at, columns, reach, _ = turns
    low, high = np.full((n_y, n_v), lanes), np.full((n_y, n_v), 0)
    for marked, following in ((marks, False), (marks_after, True)):
        for y in range(n_y):
            for v in range(n_v):
                if not marked[y, v]:
                    continue
                first, last = 0, BLOCKS
                while not marked[y, v] >> _U(first) & _U(1):
                    first += 1
                while not marked[y, v] >> _U(last - 1) & _U(1):
                    last -= 1
                if not following:
                    low[y, v], high[y, v] = first * block, min(last * block, lanes)
                    continue
                for k in range(-reach, reach + 1):
                    for m in range(-reach, reach + 1):
                        u = velocity_at[slots[v] + k * columns + m]
                        if u < n_v:
                            row, x = y - arrival[u, 1], arrival[u, 0]
                            if 0 <= row < n_y and marks[row, u]:
                                low[row, u] = min(low[row, u], first * block - x)
                                high[row, u] = max(high[row, u], last * block - x)
    for y in range(n_y):
        for v in range(n_v):
            if marks[y, v]:
                places[y, v] = begin - low[y, v]
                begin += high[y, v] - low[y, v]
    return begin
