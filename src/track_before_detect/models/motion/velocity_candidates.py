"""Velocities that dynamic programming over whole pixels tries at every step (Fu et al. 2022).

A first-order method moves by whole pixels. A second-order one looks two frames back along a
straight line, so its velocities are multiples of half a pixel per frame: over two frames they
move by whole pixels, over one frame a half rounds either way.
"""

from collections.abc import Iterable
import itertools

import numpy as np
from numpy.typing import NDArray

# The bits of an integer limit how many values a component of a velocity can have.
FASTEST_SECOND_ORDER = 7
FASTEST_IN_32_BITS = 3


def whole_velocities(v_max: int) -> NDArray[np.int64]:
    """Return the velocities (px/frame) of a first-order method, slowest first, shape (n, 2).

    All whole velocities of which both components (x, y) are at most ``v_max``: 9 for 1, 25 for 2,
    as Table 1 of the paper counts them.
    """
    return _slowest_first(itertools.product(range(-v_max, v_max + 1), repeat=2))


def half_velocities(v_max: int) -> NDArray[np.int64]:
    """Return the velocities of a second-order method in half pixels per frame, slowest first.

    Returns
    -------
    array of int, shape (n, 2)
        x and y; both components at most ``v_max`` pixels per frame and the norm at most half a
        pixel per frame more.
    """
    most = 2 * v_max
    return _slowest_first(
        (x, y) for x, y in itertools.product(range(-most, most + 1), repeat=2)
        if x * x + y * y <= (most + 1)**2)


def straight_lines(v_max: int) -> NDArray[np.int64]:
    """Return the search list of a second-order method: 49 entries for v_max 1, 165 for 2.

    Returns
    -------
    array of int, shape (n, 3, 2)
        Velocity in half pixels per frame, displacement from the frame before and displacement
        from two frames before, each x and y: twice v, p - p1 and p - p2 of Eq. 3.
    """
    lines = []
    for velocity in half_velocities(v_max):
        rounded = [sorted({component // 2, -(-component // 2)}) for component in velocity]
        for step_x, step_y in itertools.product(*rounded):
            lines.append((velocity, (step_x, step_y), velocity))
    return np.array(lines, np.int64)


def matching_bits(velocities: NDArray, v_max: int) -> tuple[NDArray, NDArray]:
    """Return integers that tell by their bits which velocities match (Eq. 4).

    Every value of a component has a bit, those of x in the lower and those of y in the upper half.

    Parameters
    ----------
    velocities : array of int, shape (n, 2)
        In half pixels per frame, both components at most twice ``v_max``.
    v_max : int
        At most ``FASTEST_SECOND_ORDER`` pixels per frame.

    Returns
    -------
    needed, chosen : array of uint32 or uint64, shape (n,)
        The two bits of each velocity, and the bits within half a pixel per frame of it in either
        component: two velocities match where ``needed`` of one is in ``chosen`` of the other.
    """
    dtype = np.uint32 if v_max <= FASTEST_IN_32_BITS else np.uint64
    half = 4 * np.dtype(dtype).itemsize
    within = (1 << (4 * v_max + 1)) - 1
    needed, chosen = [], []
    for x, y in (velocities + 2 * v_max).tolist():
        needed.append(1 << x | 1 << (y + half))
        near_x, near_y = ((7 << bit >> 1) & within for bit in (x, y))
        chosen.append(near_x | near_y << half)
    return np.array(needed, dtype), np.array(chosen, dtype)


def _slowest_first(velocities: Iterable[tuple[int, ...]]) -> NDArray[np.int64]:
    """Sort, so that of candidates with equal value the slowest is taken."""
    ordered = sorted(velocities, key=lambda v: (v[0]**2 + v[1]**2, v[1], v[0]))
    return np.array(ordered, np.int64)
