"""Large frames searched tile by tile, with one threshold for all of them and each target once.

What a tile sees of the targets that belong to it, and of those that overlap these, is what the
whole frame shows; what is not is how these overlap others in turn, which ended outside.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
)
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.tiles import tiles_of
from track_before_detect.solvers.watch import Watch
from track_before_detect.types import FrameBatch, Progress, within, worst_status

# Two tiles find a target at the same place but for the last digits. Near the line between their
# cores both are asked for it, and paths this near each other on average are one (px).
BOTH_PX, SAME_PX = 1.0, 0.5


class _Found(Protocol):
    """A trajectory, in whatever units."""

    @property
    def positions(self) -> NDArray[np.float64]:
        """Pixels, shape (T, 2)."""

    @property
    def statistic(self) -> float:
        """Detection statistic."""


_Any = TypeVar('_Any', bound=_Found)


class TiledDetector(BatchDetector):
    """Searches frames larger than ``tile_px`` tile by tile.

    Parameters
    ----------
    options : DetectorOptions
        With ``tile_px``.
    inner : BatchDetector
        Searches a tile, with the threshold of the frame that it is part of.
    part : tuple of int
        Number of a part of the tiles, in their order, and how many there are; what others find in
        theirs is put together by :func:`each_once`.
    """

    def __init__(self, options: DetectorOptions, inner: BatchDetector,
                 part: tuple[int, int] = (0, 1)):
        super().__init__(options)
        self._inner = inner
        self._part = part
        self._psf = psf_of(options)

    def threshold(self, stamps: NDArray, shape: tuple[int, int],
                  progress: Progress | None = None) -> float:
        """Return the threshold for whole frames of this shape."""
        threshold = self._inner.threshold(stamps, shape, progress)
        self.threshold_source = self._inner.threshold_source
        return threshold

    def parts(self) -> Sequence[BatchDetector]:
        """Return the detectors that have a threshold each."""
        return self._inner.parts()

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return how to find the largest statistic in noise."""
        return self._inner.noise_study(stamps, shape)

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find the trajectories."""
        self.check_kind(batch.frames)
        shape = batch.frames.shape[1:]
        tiles = tiles_of(self.options, batch.stamps, shape, self._psf)
        number, n_parts = self._part
        tiles = tiles[number * len(tiles) // n_parts:(number + 1) * len(tiles) // n_parts]
        if not tiles:
            return BatchResult([], self.threshold(batch.stamps, shape, progress), 'converged', [])
        watch = Watch(self.options.max_time_s)
        results: list[BatchResult] = []
        found: list[list[FoundTrajectory]] = []
        for number, tile in enumerate(tiles):
            if results and watch.time_is_up():
                break
            here = earlier and replace(earlier, positions=[
                positions - tile.begin for positions in earlier.positions])
            result = self._inner.detect(
                replace(batch, frames=tile.of(batch.frames), part_of=shape),
                weights if weights is None else tile.of(weights), here,
                progress and within(progress, number / len(tiles), (number + 1) / len(tiles)))
            results.append(result)
            in_frame = [replace(one, positions=one.positions + tile.begin) for one in result.found]
            found.append([one for one in in_frame
                          if tile.depth(_middle(one, batch.stamps)) >= -BOTH_PX])
        self.threshold_source = self._inner.threshold_source
        worst = worst_status(result.status for result in results)
        return BatchResult(
            each_once(found), results[0].threshold, watch.status(worst),
            [step for result in results for step in result.history],
            float(np.fmax.reduce([result.gap for result in results])),
            float(np.fmax.reduce([result.best_statistic for result in results])))


def each_once(found: Iterable[Iterable[_Any]]) -> list[_Any]:
    """Return each target that was found in any tile, or part of the tiles, once, by statistic.

    Near the line between two tiles both have found it; the first one counts.

    Parameters
    ----------
    found : iterable of iterable
        Trajectories of each, in the order of the tiles.
    """
    kept: list[_Any] = []
    for of_tile in found:
        elsewhere = np.array([one.positions for one in kept])
        kept += [one for one in of_tile if not _is_among(one.positions, elsewhere)]
    return sorted(kept, key=lambda one: -one.statistic)


def _middle(found: FoundTrajectory, stamps: NDArray) -> NDArray[np.float64]:
    """Return where a target is in the frame, of those it is in, that is nearest to the middle."""
    present = np.flatnonzero(np.isfinite(found.positions[:, 0]))
    from_middle = np.abs(stamps[present] - 0.5 * (stamps[0] + stamps[-1]))
    return found.positions[present[np.argmin(from_middle)]]


def _is_among(positions: NDArray, others: NDArray) -> bool:
    """Return whether one of several paths (N, T, 2) is the same as one path (T, 2)."""
    if not len(others):
        return False
    distances = np.hypot(*np.moveaxis(others - positions, -1, 0))
    known = np.isfinite(distances)
    total = np.where(known, distances, 0.0).sum(axis=1)
    return bool(np.any(known.any(axis=1) & (total < SAME_PX * known.sum(axis=1))))
