"""Best path over the state graph, one segment of straight motion at a time.

Layout of every array
---------------------
Positions (y, x) of the grid lie in rows of ``stride`` numbers, of which the first ``n_x`` are
positions and the rest, at least as many as any move along x, are ``ABSENT``: so a position off the
grid, on either side, is read as absent and needs no care. Loops run over ``lanes``, n_x rounded up
to whole vectors; what they write beyond n_x is made absent again.

scores : float32, flat; row y of frame t starts at pad + (t n_y + y) stride
    Weight of each position in each frame.
value, before : float32, flat; row (y, v) of segment j starts at places[j, y, v]
    Weight of the best path up to and including one segment, by start position of the segment and
    velocity. Mostly the velocities lie between the two position axes so that one row y of all
    velocities is one contiguous block, which fits the second-level cache. Before the first lies
    a guard, a row of absent positions. The last segment is not stored.
best : float32 (Y, X)
    Largest weight over all velocities of the paths that end in a segment.
marks : uint64 (Y, V), and finished : uint64 (Y,)
    Which states are computed, and where ``best`` is: one bit for each block of ``block``
    positions, so that one number covers a row. All others keep their values.

Every value is computed by the same operations in the same order whichever others are computed
beside it, so that a table brought up to date equals a table filled from the start, bit for bit.

The loops over x are small functions of their own, see the module ``rows``. Whether targets may
enter and leave is known when the nest above them is compiled, from the type of ``costs``.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.compile_flags import FINITE
from track_before_detect.kernels.rows import (
    ABSENT,
    add_row,
    best_of_three,
    copy_row,
    fill_row,
    raise_row,
)
from track_before_detect.kernels.search.borrowed_arrays import borrowed
from track_before_detect.kernels.search.turn_simd import (
    MOST_ROWS,
    RUN_SIZE,
    turn_and_add,
    turn_and_live,
)

# Blocks of positions in a row, one for each bit of a mark.
BLOCKS = 64
# What the compiled loops take at a time.
VECTOR = 32

_U = np.uint64


class Layout(NamedTuple):
    """Where the positions lie, see above."""

    n_y: int
    n_x: int
    n_v: int
    stride: int
    lanes: int
    block: int
    pad: int
    guard: int


class Turns(NamedTuple):
    """Which velocities may follow which, and what that costs.

    Attributes
    ----------
    slots : array of int64, shape (V,)
        Where each velocity lies on a flat grid of velocities with ``columns`` columns.
    velocity_at : array of int64, shape (S,)
        Velocity at each place of that grid, V where there is none, as everywhere within ``reach``
        of its edges.
    columns : int
        Columns of that grid.
    reach : int
        Steps by which either component of the velocity may change between two segments.
    cost : float32
        Of one step.
    """

    slots: NDArray[np.int64]
    velocity_at: NDArray[np.int64]
    columns: int
    reach: int
    cost: np.float32


class Segment(NamedTuple):
    """One segment of a state graph.

    Attributes
    ----------
    offsets : array of int64, shape (V, K)
        Flat distance of the position in each of its K frames from the start in frame 0.
    rows : array of int64, shape (V, K)
        Rows of that distance.
    first_y, last_y : array of int64, shape (V,)
        Rows from which all frames stay on the grid.
    arrival : array of int64, shape (V, 2)
        Displacement (x, y) over the segment before; of no rows for the first segment.
    places, places_before : array of int64, shape (Y, V)
        Where the states of this segment and of the one before lie; zero where they are not held,
        of no rows where there are none.
    turns : Turns
        Those before the segment.
    """

    offsets: NDArray[np.int64]
    rows: NDArray[np.int64]
    first_y: NDArray[np.int64]
    last_y: NDArray[np.int64]
    arrival: NDArray[np.int64]
    places: NDArray[np.int64]
    places_before: NDArray[np.int64]
    turns: Turns


@numba.njit(**FINITE)
def _add_two(out, o, source, a, b, n):
    for x in range(_U(n)):
        out[o + x] += source[a + x] + source[b + x]


@numba.njit(**FINITE)
def _add_three(out, o, source, a, b, c, n):
    for x in range(_U(n)):
        out[o + x] += source[a + x] + source[b + x] + source[c + x]


@numba.njit(**FINITE)
def _add_four(out, o, source, a, b, c, d, n):
    for x in range(_U(n)):
        out[o + x] += (source[a + x] + source[b + x]) + (source[c + x] + source[d + x])


class EndCosts(NamedTuple):
    """What it costs a path to begin and to end within a segment.

    Attributes
    ----------
    entry : float32
        To be there from any but the first frame of the batch on.
    leaving, leaving_last : float32
        To be there no longer after a frame of the segment, and after its last.
    """

    entry: np.float32
    leaving: np.float32
    leaving_last: np.float32


@numba.njit(**FINITE)
def run_of_blocks(marks, b, n_blocks):
    """Return the first run of marked blocks from block ``b`` on: first, and one past the last."""
    if b >= n_blocks or not marks >> _U(b):
        return BLOCKS, BLOCKS
    if b == 0 and marks == ~_U(0) >> _U(BLOCKS - n_blocks):
        return 0, n_blocks
    while not marks >> _U(b) & _U(1):
        b += 1
    end = b
    while end < n_blocks and marks >> _U(end) & _U(1):
        end += 1
    return b, end


@numba.njit(**FINITE)
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
        add_row(out, o, scores, _U(start + offsets[v, t]), n)


@numba.njit(**FINITE)
def _turn_x(turns, wanted, source, before, velocity_at, reach, cost, block, lanes):
    """Write to ``turns`` the best within reach along v_x, less the cost a step, where wanted.

    The cost of a turn is the sum of its steps in v_x and v_y, so the maximum over the square of
    velocities is one over v_x and then one over v_y.

    turns : float32 (S, lanes), flat
    wanted : uint64 (S,), blocks
    source : int64 (V + 1,), where before[] holds the best paths that arrive at x = 0
    """
    n_blocks = (lanes + block - 1) // block
    for slot in range(velocity_at.size):
        b, end = run_of_blocks(wanted[slot], 0, n_blocks)
        while b < BLOCKS:
            start = b * block
            n = min(end * block, lanes) - start
            o = _U(slot * lanes + start)
            best_of_three(turns, o, before, _U(source[velocity_at[slot]] + start),
                          _U(source[velocity_at[slot - 1]] + start),
                          _U(source[velocity_at[slot + 1]] + start), n, cost)
            for k in range(2, reach + 1):
                raise_row(turns, o, before, _U(source[velocity_at[slot - k]] + start), n,
                          np.float32(k) * cost)
                raise_row(turns, o, before, _U(source[velocity_at[slot + k]] + start), n,
                          np.float32(k) * cost)
            b, end = run_of_blocks(wanted[slot], end, n_blocks)


@numba.njit(**FINITE)
def _turn_y(out, o, turns, here, step, reach, cost, n):
    """Write to out[o + x] the best within reach along v_y of what ``_turn_x`` wrote.

    ``here`` is the flat index in ``turns`` of the first state, ``step`` the distance of rows of
    velocities there.
    """
    best_of_three(out, o, turns, _U(here), _U(here - step), _U(here + step), n, cost)
    for k in range(2, reach + 1):
        raise_row(out, o, turns, _U(here - k * step), n, np.float32(k) * cost)
        raise_row(out, o, turns, _U(here + k * step), n, np.float32(k) * cost)


@numba.njit(**FINITE)
def _find_sources(source, y, arrival, places, n_y, pad):
    """Write to source[v] where the best paths of velocity v that arrive in row y are held."""
    n_v = arrival.shape[0]
    for v in range(n_v):
        row = y - arrival[v, 1]
        source[v] = pad
        if 0 <= row < n_y and places[row, v]:
            source[v] = places[row, v] - arrival[v, 0]
    source[n_v] = pad


@numba.njit(**FINITE)
def _find_run(run, n, slot, velocity_at, columns, source, places, first, offsets, n_frames, y,
              rows, n_y, absent, costs):
    """Write to ``run`` what n velocities from ``slot`` read and write, see ``turn_and_add``.

    ``absent`` is where a row of absent weights lies, for rows off the grid, which are not visited
    without ``costs``.
    """
    for k in range(n + 2):
        here = slot + (k - 1) * columns
        run[3 * k] = source[velocity_at[here]]
        run[3 * k + 1] = source[velocity_at[here - 1]]
        run[3 * k + 2] = source[velocity_at[here + 1]]
    for k in range(n):
        v = velocity_at[slot + k * columns]
        run[3 * (n + 2) + k] = places[v]
        for t in range(n_frames):
            run[4 * n + 6 + t * n + k] = first + offsets[v, t]
            if costs is not None:
                if not 0 <= y + rows[v, t] < n_y:
                    run[4 * n + 6 + t * n + k] = absent


@numba.njit(**FINITE)
def _extend_row(out, places, y, marks, before, scores, ends, layout, costs, offsets, rows,
                first_y, last_y, arrival, places_before, slots, velocity_at, columns, reach, cost,
                source, wanted, turns, run):
    """Extend the best paths by one segment in row ``y``, where marks[y] says so.

    The row of velocity v is written from out[places[v]] on. What comes after ``costs`` is of a
    ``Segment`` and its ``Turns``, then work space.
    """
    n_y, n_x, n_v, stride, lanes, block, pad, _ = layout
    n_blocks = (lanes + block - 1) // block
    starting = before.size == 0
    near = reach == 1 and not starting
    n_frames = offsets.shape[1]
    # How many neighbours along v_y are computed together, and frames met at once.
    if costs is None:
        most = MOST_ROWS if near else 1
        done = 0
        if near:
            done = 4 if n_frames >= 4 else 2 if n_frames >= 2 else 1
    else:
        most = MOST_ROWS
        done = n_frames
    first = pad + y * stride
    if not starting:
        _find_sources(source, y, arrival, places_before, n_y, pad)
        if reach > 1:
            wanted[:] = 0
            for v in range(n_v):
                for k in range(-reach, reach + 1):
                    wanted[slots[v] + k * columns] |= marks[y, v]
            _turn_x(turns, wanted, source, before, velocity_at, reach, cost, block, lanes)
    for column in range(columns):
        slot = column
        while slot < velocity_at.size:
            v = velocity_at[slot]
            if v == n_v:
                slot += columns
                continue
            inside = first_y[v] <= y < last_y[v]
            n = 1
            while n < most:
                other = velocity_at[slot + n * columns]
                if other == n_v or marks[y, other] != marks[y, v]:
                    break
                if costs is None:
                    if (first_y[other] <= y < last_y[other]) != inside:
                        break
                n += 1
            if costs is not None or (near and inside):
                _find_run(run, n, slot, velocity_at, columns, source, places, first, offsets,
                          done, y, rows, n_y, scores.size - lanes, costs)
            b, end = run_of_blocks(marks[y, v], 0, n_blocks)
            while b < BLOCKS:
                start = b * block
                stop = min(end * block, lanes)
                if costs is None:
                    if near and inside:
                        turn_and_add(out, before, scores, run, n, done, cost, start, stop)
                for k in range(n):
                    other = velocity_at[slot + k * columns]
                    o = places[other]
                    if costs is None:
                        if not inside:
                            fill_row(out, _U(o + start), stop - start, ABSENT)
                            continue
                    if starting:
                        fill_row(out, _U(o + start), stop - start, np.float32(0))
                    elif reach > 1:
                        _turn_y(out, _U(o + start), turns,
                                (slot + k * columns) * lanes + start, columns * lanes, reach,
                                cost, stop - start)
                    if costs is None:
                        # Not called for nothing: that takes as long as adding fifty numbers.
                        if done < n_frames:
                            _add_scores(out, _U(o + start), scores, offsets, other,
                                        first + start, stop - start, done)
                        for x in range(n_x, stop):
                            out[o + x] = ABSENT
                if costs is not None:
                    turn_and_live(out, before, scores, ends, run, n, n_frames, np.int64(near),
                                  cost, costs.entry, costs.leaving, costs.leaving_last, start,
                                  stop)
                    for k in range(n):
                        o = places[velocity_at[slot + k * columns]]
                        for x in range(n_x, stop):
                            out[o + x] = ABSENT
                b, end = run_of_blocks(marks[y, v], end, n_blocks)
            slot += n * columns


@numba.njit(**FINITE)
def extend_paths(value, best, before, scores, segment, layout, costs, marks, finished, first_row,
                 last_row):
    """Extend the best paths by one segment, rows ``first_row`` to ``last_row`` of ``value``.

    value[y, v, x] = max over v' near v of (before[p - arrival(v'), v'] - cost * |v - v'|)
                     + sum over frames of scores[t, p + move(t, v)],   p = (y, x)

    and best[y, x], in the blocks ``finished``, is the largest over all v. ``before`` of no states
    starts the paths: the maximum is then zero. ``value`` of no states is not kept, ``best`` of no
    rows not written.

    With ``costs`` a path may begin and end in any frame. Then value is what is reached after the
    last frame, reached_t = max(reached_(t-1), -entry) + scores[t, p + move(t, v)], in place of the
    sum, and best that of the paths that end within the segment, in whatever frame and with
    whatever velocity. Such a path lies on the grid where the target is present, and at the start
    of each segment.
    """
    n_v, n_x, lanes = layout.n_v, layout.n_x, layout.lanes
    n_blocks = (lanes + layout.block - 1) // layout.block
    # Saves 8 to 18 per cent, the more the narrower the frames; see the module ``borrowed_arrays``.
    before, scores, marks = borrowed(before), borrowed(scores), borrowed(marks)
    offsets, rows = borrowed(segment.offsets), borrowed(segment.rows)
    # Taken out once: each use of a tuple that holds arrays updates their reference counts.
    first_y, last_y, arrival = segment.first_y, segment.last_y, segment.arrival
    places_before = borrowed(segment.places_before)
    slots, velocity_at, columns, reach, cost = segment.turns
    flat_best = best.reshape(best.size)
    kept = value.size > 0
    room = np.empty(0 if kept else n_v * lanes, np.float32)
    out = borrowed(value) if kept else borrowed(room)
    own = np.arange(0, n_v * lanes, lanes).reshape(1, n_v)
    held = borrowed(segment.places) if kept else borrowed(own)
    ends = np.empty(lanes, np.float32)
    source = np.empty(n_v + 1, np.int64)
    far = before.size > 0 and reach > 1
    wanted = np.empty(velocity_at.size, np.uint64)
    turns = np.full(velocity_at.size * lanes if far else 0, ABSENT)
    run = np.empty(RUN_SIZE + MOST_ROWS * offsets.shape[1], np.int64)
    for y in range(first_row, last_row):
        some = _U(0)
        for v in range(n_v):
            some |= marks[y, v]
        if not some:
            continue
        places = held[y if kept else 0]
        if costs is not None:
            fill_row(ends, _U(0), lanes, ABSENT)
        _extend_row(out, places, y, marks, before, scores, ends, layout, costs, offsets, rows,
                    first_y, last_y, arrival, places_before, slots, velocity_at, columns, reach,
                    cost, source, wanted, turns, run)
        if best.size == 0:
            continue
        b, end = run_of_blocks(finished[y], 0, n_blocks)
        while b < BLOCKS:
            start = b * layout.block
            n = min(end * layout.block, n_x) - start
            o = _U(y * n_x + start)
            if costs is None:
                fill_row(flat_best, o, n, ABSENT)
                for v in range(n_v):
                    raise_row(flat_best, o, out, _U(places[v] + start), n, np.float32(0))
            else:
                copy_row(flat_best, o, ends, _U(start), n)
            b, end = run_of_blocks(finished[y], end, n_blocks)
    # Not to be freed before, for it was borrowed.
    room[:0] = 0
    own[:0] = 0
