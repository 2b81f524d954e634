"""Several targets by dynamic programming, one after the other (Guo et al. 2018, Section 3).

The merit function I(x_k) = z_k(x_k) + max I(x_{k-1}) runs over whole pixels with a transition set
of predecessors (Eq. 9). The best path above the threshold V_DT is a target; its measurements are
taken out of the frames and the merit function is computed again, until it stays below V_DT
(Section 3.1, after Yi et al. 2013). For point targets a measurement is one pixel. For blurred ones
z is the matched filter statistic, and what a target adds to that of its neighbours is taken out
as well.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels import transition_dp
from track_before_detect.models.motion.transition_sets import TransitionSets
from track_before_detect.solvers.pixel_statistics import Measurements, Merit

# Found in one direction, at most: what rounding leaves of an extremely bright target could be
# followed for long.
MOST_TARGETS = 1000
# Smaller batches, in pixels, are searched before a thread has started.
LEAST_FOR_THREADS = 100_000
# Two tracks that share more than this part of their pixels are one (Section 3.2.2, step 3).
COINCIDENCE = 0.5


class Track(NamedTuple):
    """A target as one search found it.

    Attributes
    ----------
    pixels : array of int32, shape (T, 2)
        x and y.
    seen : array, shape (T,)
        Matched filter statistic of each frame, complex for complex frames.
    value : float
        Merit of its path.
    """

    pixels: NDArray[np.int32]
    seen: NDArray
    value: float


class Search(NamedTuple):
    """What one search over one transition set found.

    Attributes
    ----------
    tracks : list of Track
        In the order they were found.
    largest_left : float
        Largest merit at the end.
    n_candidates : int
        Predecessors that were looked at.
    """

    tracks: list[Track]
    largest_left: float
    n_candidates: int


class TargetSearch:
    """Searches one batch for targets.

    Parameters
    ----------
    measurements : Measurements
        The frames.
    exclusion : array, shape (2 K - 1, 2 K - 1)
        Largest statistic of a target in the middle pixel that leaves each pixel in use.
    merit : Merit
        What is added up.
    """

    def __init__(self, measurements: Measurements, exclusion: NDArray, merit: Merit):
        self._measurements = measurements
        self._exclusion = np.ascontiguousarray(exclusion, np.float32)
        self._merit = merit
        self.scores = measurements.scores(merit)

    def run(self, sets: TransitionSets, bound: float) -> Search:
        """Find target after target over one transition set (MT; steps 2.1-2.3 of PC).

        Parameters
        ----------
        sets : TransitionSets
            Predecessors.
        bound : float
            V_DT, on the merit.
        """
        data, merit = self._measurements, self._merit
        scores = self.scores.copy() if np.isfinite(bound) else self.scores
        paths = np.empty((MOST_TARGETS, len(data.phi), 2), np.int32)
        seen = np.empty((MOST_TARGETS, len(data.psi), len(data.phi)), np.float32)
        values = np.empty(MOST_TARGETS, np.float32)
        found, left, n_candidates = transition_dp.find_targets(
            data.psi, data.phi, data.weights, data.stamp, self._exclusion, merit.squared,
            merit.signed, scores, np.empty_like(scores), np.zeros(data.psi.shape, np.float32),
            np.zeros(data.phi.shape, bool), sets.rows, sets.row_first, sets.sets,
            np.float32(bound), paths, seen, values)
        parts = seen[:found].astype(float)
        statistics = parts[:, 0] + 1j * parts[:, 1] if len(data.psi) == 2 else parts[:, 0]
        tracks = [Track(paths[i].copy(), statistics[i], float(values[i])) for i in range(found)]
        return Search(tracks, float(left), int(n_candidates))

    def run_parallel(self, directions: Sequence[TransitionSets], bound: float,
                     n_threads: int) -> list[Search]:
        """Search all directions apart from each other, on threads (PC, step 2)."""
        if n_threads == 1 or self.scores.size < LEAST_FOR_THREADS:
            return [self.run(sets, bound) for sets in directions]
        with ThreadPoolExecutor(min(n_threads, len(directions))) as pool:
            return list(pool.map(lambda sets: self.run(sets, bound), directions))

    def largest_merit(self, directions: Sequence[TransitionSets]) -> float:
        """Return the largest merit of any path."""
        return max(self.run(sets, np.inf).largest_left for sets in directions)

    def fuse(self, searches: Sequence[Search], bound: float) -> list[Track]:
        """Merge the tracks of all directions, best first (PC, step 3).

        A track is one with the better ones where it coincides with them in more than half of its
        pixels. A search in a wrong direction also picks up single pixels of targets it cannot
        follow; so what is left of a track without them has to have more merit per pixel than the
        threshold asks for (docs/constants/solvers.md).
        """
        tracks = sorted((track for search in searches for track in search.tracks),
                        key=lambda track: -track.value)
        if not tracks:
            return []
        n_frames, n_y, n_x = self.scores.shape
        x, y = np.array([track.pixels for track in tracks]).transpose(2, 0, 1)
        pixels = (np.arange(n_frames) * n_y + y) * n_x + x
        merits = self.scores.ravel()[pixels]
        taken = np.zeros(self.scores.shape, bool)
        kept: list[Track] = []
        for track, places, merit in zip(tracks, pixels, merits, strict=True):
            own = ~taken.ravel()[places]
            n_own = np.count_nonzero(own)
            if n_own < (1 - COINCIDENCE) * n_frames or not (
                    merit[own].sum() * n_frames > bound * n_own):
                continue
            kept.append(track)
            self._mark(taken, track)
        return kept

    def amplitudes(self, track: Track) -> NDArray:
        """Return the amplitudes (T,) of the unit-norm PSF, 0 where nothing was seen."""
        x, y = track.pixels.T
        phi = self._measurements.phi[np.arange(len(x)), y, x]
        return np.where(track.seen != 0, track.seen / np.sqrt(np.maximum(phi, 1e-9)), 0)

    def _mark(self, taken: NDArray, track: Track) -> None:
        """Mark the pixels that a track spoils for others."""
        half = self._exclusion.shape[0] // 2
        t, dy, dx = np.nonzero(np.abs(track.seen)[:, None, None] > self._exclusion)
        x, y = (track.pixels[t] + np.stack([dx, dy], axis=1) - half).T
        inside = (x >= 0) & (x < taken.shape[2]) & (y >= 0) & (y < taken.shape[1])
        taken[t[inside], y[inside], x[inside]] = True
