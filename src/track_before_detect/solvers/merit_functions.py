"""Merit functions of whole frames by dynamic programming (Fu et al. 2022, Eq. 2-9, Algorithm 1).

======= ============ ================================================================
method  order        the merit function I of a pixel p in frame t
======= ============ ================================================================
cfo_dp  first        X(t, p) + max I(t - 1, p - v), v whole
cso_dp  second       X(t, p) + I(t - 1, p1), with the v that maximises
                     I(t - 1, p1) + X(t - 2, p2)
mff_dp  second       X(t, p) + max (I(t - 1, p1) + I(t - 2, p2)) / 2
======= ============ ================================================================

X are the observations; the second-order methods take v in half pixels per frame, p1 and p2 on the
straight line through p, and require that v is within half a pixel per frame of the velocities
chosen in p1 and p2 (Eq. 4). A pixel that no candidate of positive merit reaches starts anew, with
a velocity that is not known and so matches any. The paper names ``cso_dp`` ("dynamic programming
with backtracking") without a formula; the one above is our reading, with the sum of three frames
on a straight line in place of Eq. 6 to start from.

``cfo_dpr``, ``cso_dpr`` and ``mff_dpr`` are the ring forms: a pass forward, a pass backward that
goes on from it, the first frames of the forward pass again, and the mean of the merit functions of
both directions. Algorithm 1 counts its steps to 2 N, so the forward pass is not made again beyond
its fourth frame (beyond its first for the first order).
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.kernels import first_order, second_order
from track_before_detect.models.velocity_candidates import half_velocities

# Bits for the values of one velocity component limit how fast a second-order search can be.
FASTEST_SECOND_ORDER = 7
FASTEST_IN_32_BITS = 3
# Frames that are worked on before threads wait for each other, and the share of its rows that a
# band may compute a second time because of it.
MOST_FRAMES_IN_BLOCK = 16
REPEATED_ROWS = 0.1


@dataclass(frozen=True)
class Method:
    """One of the six methods.

    Attributes
    ----------
    order : str
        ``"cfo"``, ``"cso"`` or ``"mff"``.
    ring : bool
        Whether the frames are passed through in both directions.
    """

    order: str
    ring: bool

    @property
    def name(self) -> str:
        """Name as a detector."""
        return f'{self.order}_dp{"r" if self.ring else ""}'

    @property
    def fewest_frames(self) -> int:
        """Frames without which there is no candidate."""
        return 1 if self.order == 'cfo' else 3


METHODS = {method.name: method for method in (
    Method(order, ring) for ring in (False, True) for order in ('cfo', 'cso', 'mff'))}


def merit_functions(observations: NDArray, method: str, v_max: int,
                    n_threads: int = 1) -> NDArray[np.float32]:
    """Return the merit function of every pixel in every frame.

    Parameters
    ----------
    observations : array, shape (T, H, W)
        Values that a target raises: pixels of point targets, else the matched filter statistic.
    method : str
        One of ``METHODS``.
    v_max : int
        Largest velocity in pixels per frame.
    n_threads : int
        Threads that share the rows of the frames.

    Returns
    -------
    float32 array, shape (T, H, W)
        I^(+t) of a plain method, I^(*t) of a ring (Eq. 9). The first two frames of a plain
        second-order method are the observations.
    """
    chosen = _checked(observations, method, v_max)
    frames = np.ascontiguousarray(observations, np.float32)
    accumulate = _FirstOrder if chosen.order == 'cfo' else _SecondOrder
    passes = accumulate(frames, chosen.order, v_max, n_threads)
    forward = np.empty_like(frames)
    passes.begin(forward)
    passes.run(forward, passes.memory, len(frames), 1)
    if not chosen.ring:
        return forward
    backward = np.empty_like(frames)
    backward[-passes.memory:] = forward[-passes.memory:]
    passes.run(backward, len(frames) - 1 - passes.memory, -1, -1)
    forward[:passes.memory] = backward[:passes.memory]
    passes.run(forward, passes.memory, min(passes.memory + passes.again, len(frames)), 1)
    forward += backward
    forward *= np.float32(0.5)
    return forward


class _Passes:
    """What both orders share: bands of rows on threads, blocks of frames."""

    def __init__(self, frames, v_max, n_threads):
        self.frames = frames
        self.v_max = v_max
        n_y = frames.shape[1]
        self._n_bands = max(1, min(n_threads, n_y // max(1, 8 * v_max)))
        self._block = MOST_FRAMES_IN_BLOCK
        if self._n_bands > 1:
            rows = n_y / self._n_bands
            self._block = int(np.clip(2 * REPEATED_ROWS * rows / max(v_max, 1), 1, self._block))

    def over_bands(self, start, stop, step, work):
        """Call work(first frame, number of frames, first row, last row) for all frames."""
        n_y = self.frames.shape[1]
        blocks = [(first, min(self._block, abs(stop - first)))
                  for first in range(start, stop, step * self._block)]
        if self._n_bands == 1:
            for first, n_steps in blocks:
                work(first, n_steps, 0, n_y)
            return
        bounds = np.linspace(0, n_y, self._n_bands + 1).astype(int)
        with ThreadPoolExecutor(self._n_bands) as pool:
            for first, n_steps in blocks:
                list(pool.map(lambda low, high, first=first, n_steps=n_steps: work(
                    first, n_steps, low, high), bounds[:-1], bounds[1:]))


class _FirstOrder(_Passes):
    """Passes of cfo_dp."""

    # Frames that a step looks back, and steps that Algorithm 1 makes after it turned again.
    memory = 1
    again = 0

    def __init__(self, frames, order, v_max, n_threads):
        super().__init__(frames, v_max, n_threads)

    def begin(self, merit):
        merit[0] = self.frames[0]

    def run(self, merit, start, stop, step):
        self.over_bands(start, stop, step, lambda first, n_steps, low, high:
                        first_order.accumulate(merit, self.frames, first, n_steps, step,
                                               self.v_max, low, high))


class _SecondOrder(_Passes):
    """Passes of cso_dp and mff_dp."""

    memory = 2
    again = 2

    def __init__(self, frames, order, v_max, n_threads):
        super().__init__(frames, v_max, n_threads)
        self._order = order
        dtype = np.uint32 if v_max <= FASTEST_IN_32_BITS else np.uint64
        # The states hold velocities of forward time; passed through backward, the same candidates
        # in the same order have the opposite ones.
        self._candidates = {
            step: (step * half_velocities(v_max),
                   *_velocity_bits(step * half_velocities(v_max), v_max, dtype))
            for step in (1, -1)}
        n_planes = self._block + self.memory
        self._states = np.full((n_planes + 1, *frames.shape[1:]), np.iinfo(dtype).max, dtype)
        self._begun = False

    def begin(self, merit):
        merit[:2] = self.frames[:2]

    def run(self, merit, start, stop, step):
        if not self._begun:
            # Without known velocities two frames are begun from the observations (Eq. 6).
            self._begun = True
            begun = min(start + 2, stop)
            going_on = second_order.MEAN if self._order == 'mff' else second_order.SUM
            self._accumulate(merit, self.frames, self.frames, start, begun, step, False, going_on)
            start = begun
        if self._order == 'mff':
            self._accumulate(merit, merit, merit, start, stop, step, True, second_order.MEAN)
        else:
            self._accumulate(merit, merit, self.frames, start, stop, step, True,
                             second_order.FIRST)

    def _accumulate(self, merit, first, second, start, stop, step, matching, going_on):
        self.over_bands(start, stop, step, lambda frame, n_steps, low, high:
                        second_order.accumulate(
                            merit, self._states, first, second, self.frames, frame, n_steps, step,
                            *self._candidates[step], matching, going_on, low, high))


def _velocity_bits(velocities, v_max, dtype):
    """Return the bits that each velocity needs, and those it leaves when chosen."""
    half = 4 * np.dtype(dtype).itemsize
    within = (1 << (4 * v_max + 1)) - 1
    needed, chosen = [], []
    for x, y in (velocities + 2 * v_max).tolist():
        needed.append(1 << x | 1 << (y + half))
        near_x, near_y = ((7 << bit >> 1) & within for bit in (x, y))
        chosen.append(near_x | near_y << half)
    return np.array(needed, dtype), np.array(chosen, dtype)


def _checked(observations, method, v_max):
    """Refuse what cannot be accumulated; return the method."""
    if method not in METHODS:
        raise ParameterError(f'method must be one of {", ".join(METHODS)}, got {method!r}')
    chosen = METHODS[method]
    if not (isinstance(v_max, (int, np.integer)) and v_max >= 0):
        raise ParameterError(f'v_max must be a whole number of at least 0 px/frame, got {v_max!r}')
    if chosen.order != 'cfo' and v_max > FASTEST_SECOND_ORDER:
        raise ParameterError(
            f'{method} searches up to {FASTEST_SECOND_ORDER} pixels per frame, got {v_max}')
    if np.ndim(observations) != 3 or 0 in np.shape(observations):
        raise DataError('observations must have shape (T, H, W) with no empty side, got '
                        f'{np.shape(observations)}')
    if np.iscomplexobj(observations):
        raise DataError(f'{method} needs real observations, got complex numbers')
    if len(observations) < chosen.fewest_frames:
        raise DataError(f'{method} needs at least {chosen.fewest_frames} frames, '
                        f'got {len(observations)}')
    return chosen
