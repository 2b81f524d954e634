"""Best path over the state graph of targets that may enter and leave during the batch.

Being present costs ``presence`` a frame, entering after the first frame costs ``entry``, leaving
before the last one ``leaving``. Along a straight segment, with s_t the weight met in frame t,

    reached_t = max(reached_(t-1), -entry) + s_t - presence,

so that a path may begin in any frame, and the largest of reached_t - leaving over all frames is
that of the best path that ends in any.

Layout of every array
---------------------
As in the module ``path_search``, and

ends : float32 (Y, X)
    Weight of the best path that ends in the segment, in whatever frame and with whatever
    velocity, by its position at the start of the segment.

A segment need not lie on the grid as a whole: only where the target is present, and at its start.
"""

import numba
import numpy as np

from track_before_detect.kernels.path_search import (
    ABSENT,
    best_turn_x,
    best_turn_y,
    fill_row,
    row_width,
    shifted_row,
)

_COMPILE = {'nogil': True, 'cache': True, 'fastmath': {'nnan', 'ninf', 'nsz'}}
_U = np.uint64


@numba.njit(**_COMPILE)
def _live_on(out, o, ends, e, scores, a, n, presence, entry, leaving):
    for x in range(_U(n)):
        reached = out[o + x] if out[o + x] > -entry else -entry
        reached += scores[a + x] - presence
        out[o + x] = reached
        end = reached - leaving
        ends[e + x] = ends[e + x] if ends[e + x] > end else end


@numba.njit(**_COMPILE)
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
    width = row_width(row_first, row_x)
    stride = width * n_x
    n_rows = row_x.size
    turns = np.empty(n_rows * stride, np.float32)
    for y in range(first_row, last_row):
        block = y * n_v * n_x
        fill_row(flat_ends, _U(y * n_x), n_x, ABSENT)
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
                if starting:
                    fill_row(flat, o, n_x, np.float32(0))
                else:
                    column = (row_x[r] + v - row_first[r]) * n_x
                    best_turn_y(flat, o, turns, column, stride, r, n_rows, n_x, reach, cost)
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
