"""Merit functions in plain vectorised NumPy, as a measure of the compiled ones (Fu et al. 2022).

One array operation at a time over all pixels of a frame, candidate after candidate, with buffers
that are kept; forward only.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from track_before_detect.models.motion.velocity_candidates import (
    matching_bits,
    straight_lines,
    whole_velocities,
)


def numpy_merit_functions(frames: NDArray, order: str, v_max: int) -> NDArray[np.float32]:
    """Return what merit_functions returns for ``order`` followed by ``_dp``.

    Parameters
    ----------
    frames : float32 array, shape (T, H, W)
        Observations.
    order : str
        ``"cfo"``, ``"cso"`` or ``"mff"``.
    v_max : int
        Largest velocity in pixels per frame.
    """
    if order == 'cfo':
        return first_order(frames, v_max)
    merit = np.empty_like(frames)
    search = _SecondOrder(frames, order, v_max)
    merit[:2] = frames[:2]
    for t in range(2, len(frames)):
        search.step(merit, t)
    return merit


def first_order(frames: NDArray, v_max: int, velocities: NDArray | None = None,
                memory: float = 1.0) -> NDArray[np.float32]:
    """Accumulate over given velocities (all whole ones unless given), with a memory coefficient.

    The coefficient of Succary et al. 2003 weighs what comes from the frame before.
    """
    merit = np.empty_like(frames)
    merit[0] = frames[0]
    before = Padded(frames.shape[1:], v_max, -np.inf)
    best = np.empty_like(frames[0])
    for t in range(1, len(frames)):
        before.fill(merit[t - 1])
        best.fill(-np.inf)
        for velocity in whole_velocities(v_max) if velocities is None else velocities:
            np.maximum(best, before.moved(velocity), out=best)
        if memory != 1:
            best *= np.float32(memory)
        np.add(frames[t], best, out=merit[t])
    return merit


class Padded:
    """An image with a border, seen from pixels that moved."""

    def __init__(self, shape: tuple[int, ...], border: int, outside: float,
                 dtype: DTypeLike = np.float32):
        self._border = border
        self._image = np.full([n + 2 * border for n in shape], outside, dtype)
        self._shape = shape

    def fill(self, image: ArrayLike) -> None:
        """Put in an image, or a number everywhere, inside the border."""
        self.moved((0, 0))[:] = image

    def moved(self, displacement: Sequence[int]) -> NDArray:
        """Return what was at p - displacement (x, y) of every pixel p."""
        rows, columns = (slice(self._border - move, self._border - move + length)
                         for move, length in zip(displacement[::-1], self._shape, strict=True))
        return self._image[rows, columns]


class _SecondOrder:
    """Steps of cso_dp and mff_dp."""

    def __init__(self, frames: NDArray, order: str, v_max: int):
        shape = frames.shape[1:]
        self._frames, self._averaging = frames, order == 'mff'
        lines = straight_lines(v_max)
        needed, chosen = matching_bits(lines[:, 0], v_max)
        self._candidates = list(zip(lines[:, 1].tolist(), lines[:, 2].tolist(), needed, chosen,
                                    strict=True))
        self._merits = [Padded(shape, 2 * v_max, -np.inf) for _ in range(2)]
        # Nothing outside matches, everything matches where no velocity was chosen.
        self._states = [Padded(shape, 2 * v_max, 0, needed.dtype) for _ in range(2)]
        self._unknown = np.iinfo(needed.dtype).max
        self._chosen = np.full((3, *shape), self._unknown, needed.dtype)
        self._best, self._kept, self._value = (np.empty(shape, np.float32) for _ in range(3))
        self._better, self._matches = np.empty(shape, bool), np.empty(shape, bool)
        self._bits = np.empty(shape, needed.dtype)

    def step(self, merit: NDArray, t: int) -> None:
        """Write the merit function of frame t."""
        starting = t < 4
        self._merits[0].fill((self._frames if starting else merit)[t - 1])
        self._merits[1].fill((merit if self._averaging and not starting else self._frames)[t - 2])
        for back in (1, 2):
            self._states[back - 1].fill(
                self._unknown if starting else self._chosen[(t - back) % 3])
        chosen = self._chosen[t % 3]
        chosen.fill(self._unknown)
        self._best.fill(-np.inf if starting else 0)
        self._kept.fill(0)
        for one_back, two_back, needed, left in self._candidates:
            first, second = self._merits[0].moved(one_back), self._merits[1].moved(two_back)
            np.add(first, second, out=self._value)
            np.greater(self._value, self._best, out=self._better)
            for states, back in zip(self._states, (one_back, two_back), strict=True):
                np.bitwise_and(states.moved(back), needed, out=self._bits)
                np.equal(self._bits, needed, out=self._matches)
                np.logical_and(self._better, self._matches, out=self._better)
            np.copyto(self._best, self._value, where=self._better)
            np.copyto(chosen, left, where=self._better)
            if not self._averaging:
                np.copyto(self._kept, first, where=self._better)
        if self._averaging:
            self._best *= np.float32(0.5)
        np.add(self._frames[t], self._best if self._averaging or starting else self._kept,
               out=merit[t])
