"""Merit functions of second-order dynamic programming over whole pixels (Fu et al. 2022, Eq. 2-6).

Layout of every array
---------------------
frames, merit : as in the module ``first_order``
    Frame t of the merit is in plane t % L.
states : uint32 or uint64 (K + 1, H, W)
    Velocities that match the one chosen in each pixel, one bit for each value of v_x in the lower
    half and of v_y in the upper half; frame t is in plane t % K. A chosen velocity leaves the
    three bits around its own in either half, and all bits are set where none was chosen, as in the
    last plane throughout. Velocities are those of forward time in both directions.
velocities : int64 (V, 2)
    x and y in half pixels per frame.
needed, chosen : as states (V,)
    The two bits of each velocity, and the bits it leaves when chosen.

The candidates of one velocity differ in the pixel of the frame before alone, so the largest of
their merits is taken first, and the matching and the frame before that enter once. The loops over
x are small functions of their own, see the module ``rows``.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FUSED, Offset
from track_before_detect.kernels.rows import ABSENT, copy_row

# How the merit of the frame before and what is added to it from two frames before go on: their
# mean, their sum, or the merit of the frame before alone.
MEAN, SUM, FIRST = 0, 1, 2

_U = Offset


@numba.njit(**FUSED)
def _matching(value, state, needed):
    return value if state & needed == needed else ABSENT


@numba.njit(**FUSED)
def _one(out, first, states, a, s, needed, n):
    for x in range(_U(n)):
        out[x] = _matching(first[a + x], states[s + x], needed)


@numba.njit(**FUSED)
def _best_of_two(out, first, states, a, s, apart, needed, n):
    for x in range(_U(n)):
        here = _matching(first[a + x], states[s + x], needed)
        there = _matching(first[a - apart + x], states[s - apart + x], needed)
        out[x] = here if here > there else there


@numba.njit(**FUSED)
def _raise_to_best_of_two(out, first, states, a, s, apart, needed, n):
    for x in range(_U(n)):
        here = _matching(first[a + x], states[s + x], needed)
        there = _matching(first[a - apart + x], states[s - apart + x], needed)
        best = here if here > there else there
        out[x] = out[x] if out[x] > best else best


@numba.njit(**FUSED)
def _take_better(best, best_states, o, before, second, states, b, s, needed, chosen, n):
    for x in range(_U(n)):
        value = before[x] + _matching(second[b + x], states[s + x], needed)
        old, old_state = best[o + x], best_states[o + x]
        best[o + x] = value if value > old else old
        best_states[o + x] = chosen if value > old else old_state


@numba.njit(**FUSED)
def _keep_first(best, kept, o, before, second, states, b, s, needed, n):
    for x in range(_U(n)):
        here, old = before[x], kept[o + x]
        value = here + _matching(second[b + x], states[s + x], needed)
        kept[o + x] = here if value > best[o + x] else old


@numba.njit(**FUSED)
def _add_scaled(out, o, frames, a, best, factor, n):
    for x in range(_U(n)):
        out[o + x] = frames[a + x] + factor * best[x]


@numba.njit(**FUSED)
def accumulate(merit, states, first, second, frames, start, n_steps, step, velocities, needed,
               chosen, matching, going_on, first_row, last_row):
    """Write the merit and the state of the frames start, start + step, ...

    For each velocity v the best is E(p, v) = max over p1 of first[t - step, p1]
    + second[t - 2 step, p2], where p2 = p - 2 v step and p1 = p - v step, a half rounded either
    way. With ``matching``, p1 and p2 count only if their velocities are within half a pixel per
    frame of v, and where no E is above zero the velocity is unknown and E is 0, as Eq. 3 has it;
    without, all count (Eq. 6). The best E over all v, going on as ``going_on`` says, is added to
    frames[t].

    ``first`` and ``second`` are ``merit`` or ``frames``; ``step`` is 1 or -1. Rows ``first_row``
    to ``last_row`` of the last of the ``n_steps`` frames are written, and of the others as many
    more as they depend on, so that bands of rows can be worked on apart from each other: where two
    bands write the same number it has the same value. The planes of these frames and of the two
    before have to be different ones.
    """
    n_merits, n_y, n_x = merit.shape
    n_firsts, n_seconds = first.shape[0], second.shape[0]
    n_planes = states.shape[0] - 1
    out, out_states = merit.reshape(merit.size), states.reshape(states.size)
    flat_first, flat_second = first.reshape(first.size), second.reshape(second.size)
    flat_frames = frames.reshape(frames.size)
    unknown = states[n_planes, 0, 0]
    floor = np.float32(0) if matching else ABSENT
    before, kept = np.empty(n_x, np.float32), np.empty(n_x, np.float32)
    # A row is written once, when it is done: another thread may read it.
    best, best_states = np.empty(n_x, np.float32), np.empty(n_x, states.dtype)
    most = np.max(np.abs(velocities)) // 2
    for k in range(n_steps):
        t = start + k * step
        plane_1 = ((t - step) % n_planes if matching else n_planes) * n_y
        plane_2 = ((t - 2 * step) % n_planes if matching else n_planes) * n_y
        more = most * (n_steps - 1 - k)
        for y in range(max(0, first_row - more), min(n_y, last_row + more)):
            best[:] = floor
            best_states[:] = unknown
            kept[:] = np.float32(0)
            for v in range(velocities.shape[0]):
                move_x, move_y = velocities[v, 0] * step, velocities[v, 1] * step
                if y - move_y < 0 or y - move_y >= n_y:
                    continue
                # Where p2 is inside, so is p1, which lies between p2 and p.
                x = max(0, move_x)
                n = min(n_x, n_x + move_x) - x
                if n <= 0:
                    continue
                row, column = y - (move_y >> 1), x - (move_x >> 1)
                a = _U(((t - step) % n_firsts * n_y + row) * n_x + column)
                s = _U((plane_1 + row) * n_x + column)
                # A half in one component rounds to two pixels, a half in both to four.
                if move_x & 1:
                    _best_of_two(before, flat_first, out_states, a, s, _U(1), needed[v], n)
                    if move_y & 1:
                        _raise_to_best_of_two(before, flat_first, out_states, a - _U(n_x),
                                              s - _U(n_x), _U(1), needed[v], n)
                elif move_y & 1:
                    _best_of_two(before, flat_first, out_states, a, s, _U(n_x), needed[v], n)
                else:
                    _one(before, flat_first, out_states, a, s, needed[v], n)
                a = _U(((t - 2 * step) % n_seconds * n_y + y - move_y) * n_x + x - move_x)
                s = _U((plane_2 + y - move_y) * n_x + x - move_x)
                if going_on == FIRST:
                    _keep_first(best, kept, _U(x), before, flat_second, out_states, a, s,
                                needed[v], n)
                _take_better(best, best_states, _U(x), before, flat_second, out_states, a, s,
                             needed[v], chosen[v], n)
            _add_scaled(out, _U((t % n_merits * n_y + y) * n_x), flat_frames,
                        _U((t * n_y + y) * n_x), kept if going_on == FIRST else best,
                        np.float32(0.5) if going_on == MEAN else np.float32(1), n_x)
            copy_row(out_states, _U((t % n_planes * n_y + y) * n_x), best_states, _U(0), n_x)
