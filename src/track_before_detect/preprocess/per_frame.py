"""Work on each frame by itself: shared out over threads, and kept while batches overlap."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from track_before_detect.parallel import map_in_threads

_Result = TypeVar('_Result')

# Pixels of a batch below which threads cost more than they gain.
_FEW_PIXELS = 200_000


def shown(frames: NDArray) -> NDArray[np.bool_]:
    """Return which frames, shape (T, H, W), hold any data: an array of shape (T,)."""
    # The first row of a frame all but always tells.
    return np.array([any(np.isfinite(row).any() for row in frame) for frame in frames], bool)


def each_frame(work: Callable[..., _Result], frames: NDArray | Sequence[NDArray],
               *others: Iterable[Any]) -> list[_Result]:
    """Return ``work(frame, other, ...)`` of each frame, which must not depend on their order."""
    items = list(zip(frames, *others, strict=True))
    if sum(frame.size for frame in frames) < _FEW_PIXELS:
        return [work(*item) for item in items]
    return map_in_threads(lambda item: work(*item), items)


class KeptFrames:
    """Does work on each frame, and remembers it while batches overlap.

    Parameters
    ----------
    n_kept : int
        The last frames of each batch of which the work is kept: those the next one holds again.
    """

    def __init__(self, n_kept: int = 0):
        self._n_kept = n_kept
        self._kept: dict[tuple[Hashable, ...], dict[int, tuple[NDArray, Any]]] = {}

    def each(self, work: Callable[..., _Result], frames: NDArray, numbers: NDArray[np.int64],
             *parameters: Hashable) -> list[_Result]:
        """Return ``work(frame, *parameters)`` of each frame, which is not to be written to.

        What was kept is returned only where the pixels of the frame are the same to the last bit.

        Parameters
        ----------
        work : callable
        frames : array, shape (T, H, W)
        numbers : array of int, shape (T,)
            Of the frames in their recording.
        *parameters
            The same for all frames.
        """
        key = (work, *parameters)
        kept = self._kept.pop(key, {})
        results = {t: kept[number][1] for t, number in enumerate(numbers.tolist())
                   if number in kept and _same(kept[number][0], frames[t])}
        missing = [t for t in range(len(frames)) if t not in results]
        results.update(zip(missing, each_frame(
            lambda frame: work(frame, *parameters), [frames[t] for t in missing]), strict=True))
        first = max(len(frames) - self._n_kept, 0)
        # A copy: the frames may be changed in place, and are a part of all those of their batch.
        self._kept[key] = {int(numbers[t]): (frames[t].copy(), results[t])
                           for t in range(first, len(frames))}
        return [results[t] for t in range(len(frames))]


def _same(one: NDArray, other: NDArray) -> bool:
    """Return whether two frames are equal, NaN included."""
    return (one.shape == other.shape and one.dtype == other.dtype
            and np.array_equal(one.view(np.uint32), other.view(np.uint32)))
