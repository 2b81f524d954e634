"""Shift-and-stack over constant velocities: the best velocity for each position.

Layout of every array
---------------------
psi, phi : float32 (T, Y, X)
    Data over variance seen through the PSF, and the squared PSF over the variance; both zero
    where nothing was measured, and taken as zero outside the grid.
moves_y : int32 (Vy, T)
    Displacement in y from the reference position to frame t, for each v_y.
first_vx, last_vx : int32 (Vy,)
    Which v_x are searched with each v_y.

Sums along x are shared between velocities. Over a few frames many velocities move by the same
whole steps, so their sums over these frames are one row; only what sets two velocities apart is
added twice. The rows of one v_y, their shared sums and both psi and phi fit in the caches next to
the processor. The plan of the sums is the caller's:

node_sources : int32 (N, 2)
    Sum number T + k is the sum of these two; numbers below T are the rows of the frames.
node_shifts : int32 (N,)
    Steps in x by which the second is shifted.
node_first, node_last : int32 (N,)
    The sum is needed from node_first on, up to node_last after the last position.
final_sources, final_shifts : int32 (Vx, G)
    Sums that make up each v_x, and their shifts.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import APPROXIMATE, Offset
from track_before_detect.kernels.rows import add_row, copy_row, fill_row

_U = Offset
# Columns searched together, and what an unrolled loop adds at once.
BLOCK = 128
STEP = 32


@numba.njit(**APPROXIMATE)
def _whole_steps(n):
    """Return n rounded up to what the unrolled loops add at once; the rest would go one by one."""
    return (n + STEP - 1) // STEP * STEP


@numba.njit(**APPROXIMATE)
def _sum_two(out, o, source, a, b, n):
    for x in range(_U(n)):
        out[o + x] = source[a + x] + source[b + x]


@numba.njit(**APPROXIMATE)
def _sum_three(out, o, source, a, b, c, n):
    for x in range(_U(n)):
        out[o + x] = source[a + x] + source[b + x] + source[c + x]


@numba.njit(**APPROXIMATE)
def _sum_four(out, o, source, a, b, c, d, n):
    for x in range(_U(n)):
        out[o + x] = (source[a + x] + source[b + x]) + (source[c + x] + source[d + x])


@numba.njit(**APPROXIMATE)
def _sum_five(out, o, source, a, b, c, d, e, n):
    for x in range(_U(n)):
        out[o + x] = ((source[a + x] + source[b + x]) + (source[c + x] + source[d + x])
                      + source[e + x])


@numba.njit(**APPROXIMATE)
def _raise_best(best, number, sums, phi, least, velocity, signed, n):
    """Raise best[x] to psi / sqrt(phi), with psi = sums[x] and phi = sums[phi + x]."""
    if signed:
        for x in range(_U(n)):
            sums[x] = abs(sums[x])
    for x in range(_U(n)):
        weight = sums[phi + x]
        value = sums[x] / np.sqrt(weight) if weight > least else np.float32(0)
        better = value > best[x]
        best[x] = value if better else best[x]
        number[x] = velocity if better else number[x]


@numba.njit(**APPROXIMATE)
def _load(rows, o, image, start, x_0, n_x, width):
    """Write an image row from column x_0 on, zero outside the image, to rows[o + x].

    ``start`` is the flat index of the first column; negative for a row outside the image.
    """
    if start < 0:
        fill_row(rows, o, width, np.float32(0))
        return
    left = min(width, max(0, -x_0))
    right = max(left, min(width, n_x - x_0))
    fill_row(rows, o, left, np.float32(0))
    copy_row(rows, o + _U(left), image, _U(start + x_0 + left), right - left)
    fill_row(rows, o + _U(right), width - right, np.float32(0))


@numba.njit(**APPROXIMATE)
def _sum_of(out, rows, sources, shifts, first, n_parts, offsets, stride, pad, n):
    """Write the sum of shifted rows, ``n_parts`` from entry ``first`` of the lists, to out[x]."""
    for g in range(n_parts):
        offsets[g] = _U(sources[first + g] * stride + pad + shifts[first + g])
    o = _U(0)
    if n_parts == 1:
        copy_row(out, o, rows, offsets[0], n)
    elif n_parts == 2:
        _sum_two(out, o, rows, offsets[0], offsets[1], n)
    elif n_parts == 3:
        _sum_three(out, o, rows, offsets[0], offsets[1], offsets[2], n)
    elif n_parts == 4:
        _sum_four(out, o, rows, offsets[0], offsets[1], offsets[2], offsets[3], n)
    else:
        _sum_five(out, o, rows, offsets[0], offsets[1], offsets[2], offsets[3], offsets[4], n)
    for g in range(5, n_parts):
        add_row(out, o, rows, offsets[g], n)


@numba.njit(**APPROXIMATE)
def best_velocities(best, number, psi, phi, moves_y, first_vx, last_vx, pad, node_sources,
                    node_shifts, node_first, node_last, final_sources, final_shifts, least,
                    signed, first_row, last_row, first_column, last_column):
    """Write the largest psi / sqrt(phi) over all velocities to a part of ``best`` (Y, X).

    ``number`` (Y, X) receives the number of the velocity, i * Vx + j for v_y number i and v_x
    number j, -1 where there is none. Sums with a phi of at most ``least`` do not count; ``signed``
    takes |psi|.
    """
    n_frames, n_y, n_x = psi.shape
    flat_psi = psi.reshape(psi.size)
    flat_phi = phi.reshape(phi.size)
    n_vx, n_parts = final_sources.shape
    flat_sources = final_sources.reshape(final_sources.size)
    flat_shifts = final_shifts.reshape(final_shifts.size)
    n_nodes = node_sources.shape[0]
    # Each row holds psi and then phi of a block of columns, so that one loop adds both.
    stride = _whole_steps(2 * (min(BLOCK, n_x) + 2 * pad) + STEP)
    rows = np.zeros((n_frames + n_nodes) * stride, np.float32)
    sums = np.empty(stride, np.float32)
    offsets = np.empty(n_parts, np.uint64)
    block_best = np.empty(BLOCK, np.float32)
    block_number = np.empty(BLOCK, np.int32)
    for y in range(first_row, last_row):
        for x_0 in range(first_column, last_column, BLOCK):
            n = min(BLOCK, last_column - x_0)
            width = n + 2 * pad
            block_best[:] = 0
            block_number[:] = -1
            for i in range(moves_y.shape[0]):
                for t in range(n_frames):
                    row = y + moves_y[i, t]
                    start = (t * n_y + row) * n_x if 0 <= row < n_y else -1
                    _load(rows, _U(t * stride), flat_psi, start, x_0 - pad, n_x, width)
                    _load(rows, _U(t * stride + width), flat_phi, start, x_0 - pad, n_x, width)
                for k in range(n_nodes):
                    first = pad + node_first[k]
                    _sum_two(rows, _U((n_frames + k) * stride + first), rows,
                             _U(node_sources[k, 0] * stride + first),
                             _U(node_sources[k, 1] * stride + first + node_shifts[k]),
                             _whole_steps(width + n + node_last[k] - node_first[k]))
                for j in range(first_vx[i], last_vx[i]):
                    _sum_of(sums, rows, flat_sources, flat_shifts, j * n_parts, n_parts, offsets,
                            stride, pad, _whole_steps(width + n))
                    _raise_best(block_best, block_number, sums, _U(width), least,
                                np.int32(i * n_vx + j), signed, _whole_steps(n))
            best[y, x_0:x_0 + n] = block_best[:n]
            number[y, x_0:x_0 + n] = block_number[:n]
