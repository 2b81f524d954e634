"""Loops over one row of numbers, which all kernels are made of.

They are small functions of their own on purpose: written into the nest above them they are not
vectorised. They take whole arrays, flat, with unsigned offsets: a slice for each row would cost
two atomic updates of a reference count, as long as adding sixty numbers, and a signed index would
be checked for being negative at each step.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.compile_flags import FINITE, Offset

ABSENT = np.float32(-1e30)
# In numbers of four bytes.
CACHE_LINE = 16

_U = Offset


@numba.njit(**FINITE)
def fill_row(out, o, n, value):
    """Write ``value`` to out[o + x]."""
    for x in range(_U(n)):
        out[o + x] = value


@numba.njit(**FINITE)
def copy_row(out, o, source, a, n):
    """Write source[a + x] to out[o + x]."""
    for x in range(_U(n)):
        out[o + x] = source[a + x]


@numba.njit(**FINITE)
def add_row(out, o, source, a, n):
    """Add source[a + x] to out[o + x]."""
    for x in range(_U(n)):
        out[o + x] += source[a + x]


@numba.njit(**FINITE)
def raise_row(out, o, source, a, n, cost):
    """Raise out[o + x] to source[a + x] - cost where that is more."""
    for x in range(_U(n)):
        other = source[a + x] - cost
        out[o + x] = out[o + x] if out[o + x] > other else other


@numba.njit(**FINITE)
def larger_of_two(out, o, source, a, b, n):
    """Write the larger of source[a + x] and source[b + x] to out[o + x]."""
    for x in range(_U(n)):
        out[o + x] = source[a + x] if source[a + x] > source[b + x] else source[b + x]


@numba.njit(**FINITE)
def largest_of_three(out, o, source, a, b, c, n):
    """Write the largest of source[a + x], source[b + x] and source[c + x] to out[o + x]."""
    for x in range(_U(n)):
        largest = source[a + x] if source[a + x] > source[b + x] else source[b + x]
        out[o + x] = largest if largest > source[c + x] else source[c + x]


@numba.njit(**FINITE)
def best_of_three(out, o, source, here, left, right, n, cost):
    """Write to out[o + x] the best of three, two of them less ``cost``."""
    for x in range(_U(n)):
        beside = source[left + x] if source[left + x] > source[right + x] else source[right + x]
        beside -= cost
        out[o + x] = source[here + x] if source[here + x] > beside else beside


def absent_rows(n_rows: int, size: int) -> NDArray[np.float32]:
    """Return rows (N, size or a little more) of absent numbers, each from a cache line on.

    Writing rows that begin in the middle of one takes a quarter longer.
    """
    size = CACHE_LINE * -(-size // CACHE_LINE)
    room = np.full(n_rows * size + CACHE_LINE, ABSENT)
    first = -(room.ctypes.data // room.itemsize) % CACHE_LINE
    return room[first:first + n_rows * size].reshape(n_rows, size)
