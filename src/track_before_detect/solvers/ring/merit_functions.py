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

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
import itertools

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.kernels.ring import first_order, passes, second_order
from track_before_detect.models.motion.velocity_candidates import (
    FASTEST_SECOND_ORDER,
    half_velocities,
    matching_bits,
)

# Frames that are worked on before threads wait for each other, and the share of its rows that a
# band may compute a second time because of it.
MOST_FRAMES_IN_BLOCK = 8
REPEATED_ROWS = 0.1

# Called with the first frame, the number of frames, the first row and the last.
Work = Callable[[int, int, int, int], None]


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
    both_ways = (_FirstOrder if chosen.order == 'cfo' else _SecondOrder)(
        frames, chosen.order, v_max, n_threads)
    merit = np.empty_like(frames)
    merit[:both_ways.memory] = frames[:both_ways.memory]
    both_ways.run(merit, both_ways.memory, len(frames), 1)
    if chosen.ring:
        both_ways.close_ring(merit)
    return merit


class _Passes(ABC):
    """What both orders share: bands of rows on threads, blocks of frames, the ring."""

    # Frames that a step looks back, and steps that Algorithm 1 makes after it turned again.
    memory: int
    again: int

    def __init__(self, frames: NDArray, order: str, v_max: int, n_threads: int):
        self.frames, self._order, self._v_max = frames, order, v_max
        n_y = frames.shape[1]
        self._n_bands = max(1, min(n_threads, n_y // max(1, 8 * v_max)))
        self.block = MOST_FRAMES_IN_BLOCK
        if self._n_bands > 1:
            rows = n_y / self._n_bands
            self.block = int(np.clip(2 * REPEATED_ROWS * rows / max(v_max, 1), 1, self.block))

    @abstractmethod
    def run(self, merit: NDArray, start: int, stop: int, step: int, *then: Work) -> None:
        """Write the merit of the frames from start to stop, ``then`` do more in each block."""

    def close_ring(self, merit: NDArray) -> None:
        """Go on backward from a forward pass and write the means over it."""
        n_frames = len(merit)
        n_planes = self.memory + max(self.block, self.again)
        backward = np.empty((n_planes, *merit.shape[1:]), np.float32)
        for t in range(n_frames - self.memory, n_frames):
            backward[t % n_planes] = merit[t]

        def average(first: int, n_steps: int, step: int, low: int, high: int) -> None:
            passes.average(merit, backward, first, n_steps, step, low, high)

        self.run(backward, n_frames - 1 - self.memory, -1, -1,
                 lambda first, n_steps, low, high: average(first, n_steps, -1, low, high))
        merit[:self.memory] = backward[:self.memory]
        stop = min(self.memory + self.again, n_frames)
        self.run(merit, self.memory, stop, 1)
        average(self.memory, stop - self.memory, 1, 0, merit.shape[1])

    def over_bands(self, start: int, stop: int, step: int, *works: Work) -> None:
        """Call each work(first frame, number of frames, first row, last row) for all frames."""
        n_y = self.frames.shape[1]
        blocks = [(first, min(self.block, abs(stop - first)))
                  for first in range(start, stop, step * self.block)]
        if self._n_bands == 1:
            for block, work in itertools.product(blocks, works):
                work(*block, 0, n_y)
            return
        bounds = np.linspace(0, n_y, self._n_bands + 1).astype(int)
        with ThreadPoolExecutor(self._n_bands) as pool:
            for block, work in itertools.product(blocks, works):
                list(pool.map(partial(work, *block), bounds[:-1], bounds[1:]))


class _FirstOrder(_Passes):
    """Passes of cfo_dp."""

    memory = 1
    again = 0

    def run(self, merit: NDArray, start: int, stop: int, step: int, *then: Work) -> None:
        def work(first: int, n_steps: int, low: int, high: int) -> None:
            first_order.accumulate(merit, self.frames, first, n_steps, step, self._v_max, low,
                                   high)

        self.over_bands(start, stop, step, work, *then)


class _SecondOrder(_Passes):
    """Passes of cso_dp and mff_dp."""

    memory = 2
    again = 2

    def __init__(self, frames: NDArray, order: str, v_max: int, n_threads: int):
        super().__init__(frames, order, v_max, n_threads)
        # The states hold velocities of forward time; passed through backward, the same candidates
        # in the same order have the opposite ones.
        self._candidates = {
            step: (step * half_velocities(v_max),
                   *matching_bits(step * half_velocities(v_max), v_max))
            for step in (1, -1)}
        dtype = self._candidates[1][1].dtype
        n_planes = self.block + self.memory
        self._states = np.full((n_planes + 1, *frames.shape[1:]), np.iinfo(dtype).max, dtype)
        self._begun = False

    def run(self, merit: NDArray, start: int, stop: int, step: int, *then: Work) -> None:
        if not self._begun:
            # Without known velocities two frames are begun from the observations (Eq. 6).
            self._begun = True
            begun = min(start + 2, stop)
            going_on = second_order.MEAN if self._order == 'mff' else second_order.SUM
            self._accumulate(merit, self.frames, self.frames, start, begun, step, False, going_on)
            start = begun
        averaging = self._order == 'mff'
        self._accumulate(merit, merit, merit if averaging else self.frames, start, stop, step,
                         True, second_order.MEAN if averaging else second_order.FIRST, *then)

    def _accumulate(self, merit: NDArray, first: NDArray, second: NDArray, start: int, stop: int,
                    step: int, matching: bool, going_on: int, *then: Work) -> None:
        def work(frame: int, n_steps: int, low: int, high: int) -> None:
            second_order.accumulate(
                merit, self._states, first, second, self.frames, frame, n_steps, step,
                *self._candidates[step], matching, going_on, low, high)

        self.over_bands(start, stop, step, work, *then)


def _checked(observations: NDArray, method: str, v_max: int) -> Method:
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
