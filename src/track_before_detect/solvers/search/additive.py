"""Largest sum over the frames of a path, less its costs: one search for each sign."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT
from track_before_detect.models.measurement.base import NO_FRAMES, Scores
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.coarse_to_fine import PathTable
from track_before_detect.solvers.search.path_tracer import TracedPath


class Additive:
    """The sum of what positions add, of which often little changes from search to search.

    Parameters
    ----------
    scores : Scores
        What a position adds.
    tables : sequence of (int, PathTable)
        One for each sign of the amplitudes, by which the scores are multiplied.
    presence : Presence, optional
        What a frame costs.
    """

    def __init__(self, scores: Scores, tables: Sequence[tuple[int, PathTable]],
                 presence: Presence | None):
        self._scores = scores
        self._tables = tables
        self._per_frame = presence.per_frame if presence else 0.0
        # The frames searched last and their scores, of no frames when nothing is known.
        self._seen = self._kept = NO_FRAMES

    def forget(self) -> None:
        """Search the next frames without looking for what they share with the last."""
        self._seen = NO_FRAMES
        for _, table in self._tables:
            table.forget()

    def largest(self, frames: NDArray) -> float:
        """Return the largest value of any path."""
        self.forget()
        scores = self._scores.scores(frames)
        return max(table.fill(_signed(scores, sign), self._per_frame)
                   for sign, table in self._tables)

    def best(self, frames: NDArray, above: float, radius: int, limit: int,
             ) -> tuple[float, list[TracedPath]]:
        """Return the largest value of any path, and paths of values above a bound, apart."""
        scores, rows = self._scores_of(frames)
        largest = max(table.update(_signed(scores, sign), above, rows, self._per_frame)
                      for sign, table in self._tables)
        return largest, [path for _, table in self._tables
                         for path in table.best_paths(above, radius, limit)]

    def _scores_of(self, frames: NDArray) -> tuple[NDArray, NDArray | None]:
        """Return scores, and which rows of them may differ from the last; None if any may.

        Often only the rows around targets differ.
        """
        if not self._scores.can_renew:
            return self._scores.scores(frames), None
        if self._seen.shape != frames.shape:
            self._kept = self._scores.scores(frames)
            self._seen = frames.copy()
            return self._kept, None
        changed = np.array([np.any(new != old, axis=1)
                            for new, old in zip(frames, self._seen, strict=True)])
        rows = self._scores.renew(self._kept, frames, changed)
        self._seen[changed] = frames[changed]
        return self._kept, rows


def _signed(scores: NDArray, sign: int) -> NDArray:
    """Return scores times a sign; where no path may be, none may be of either sign."""
    return scores if sign > 0 else np.where(scores == ABSENT, ABSENT, -scores)
