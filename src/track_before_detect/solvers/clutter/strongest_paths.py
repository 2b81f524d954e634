"""The strongest separate paths of a batch, of targets that are bright throughout or dark.

Bright and dark frames of one path do not add up, which would be one more way to follow the noise:
the two signs are searched apart, one after the other with the same tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from track_before_detect.solvers.clutter.path_tail import MOST_PATHS
from track_before_detect.solvers.path_detector import Task
from track_before_detect.solvers.refine.refinement import PathRefiner
from track_before_detect.solvers.search.path_search import FoundPath

# Paths looked at in each search, and how many of them are enough for a tail.
N_PATHS, ENOUGH = 80, 60
# Share of the value of a path below which it has lost pixels.
UNTOUCHED = 0.999


@dataclass(frozen=True)
class SignedPath(FoundPath):
    """A path along which a target is bright, or dark where the sign is -1."""

    sign: int


def strength(path: SignedPath) -> float:
    """Return the value of a path."""
    return path.value


class StrongestPaths:
    """The strongest separate paths of the frames of a batch, from which some are taken.

    Parameters
    ----------
    task : Task
        The batch, with a search for bright targets.
    refiner : PathRefiner
        Moves a path of a bright target off the grid.
    signs : sequence of int
        1 for bright targets, -1 for dark ones.
    separation : float
        Distance in pixels of paths that are separate.

    Attributes
    ----------
    frames : array, shape (T, H, W)
        Frames that are searched; call :meth:`without_touched` after a change.
    """

    def __init__(self, task: Task, refiner: PathRefiner, signs: Sequence[int],
                 separation: float):
        self._search = task.search
        self._refiner = refiner
        self._separation = separation
        # Beyond this a path sees nothing of a pixel.
        self._sees_px = task.targets.measurement.half_width + 1
        self.frames = task.paths.frames.copy()
        self._searched = signs[-1]
        self._by_sign: dict[int, list[SignedPath]] = {}
        # Value of each sign below which there are paths that no search listed.
        self._least: dict[int, float] = {}
        # Signs whose paths were found in the present frames.
        self._are_new: set[int] = set()
        # Most targets are bright: what is searched last is known when one is taken.
        for sign in reversed(signs):
            self._by_sign[sign] = self._found(sign)

    def by_strength(self) -> list[SignedPath]:
        """Return the paths, the strongest first, as far down as all of them are known.

        One that lost pixels may be weaker than many that no search listed, and says nothing of
        the tail that these belong to.
        """
        least = max(self._least.values())
        return sorted((path for found in self._by_sign.values() for path in found
                       if path.value >= least), key=strength, reverse=True)

    def refined(self, path: SignedPath) -> SignedPath:
        """Return a path moved to where it explains most."""
        frames = self._of_sign(path.sign)
        # Every threshold below a path refines it; it is not known yet.
        positions, cost = self._refiner.refine(
            frames, path.positions, path.cost, 1.0, 0.0) or (path.positions, path.cost)
        value = self._refiner.value(frames, positions, cost)
        return SignedPath(positions, value, cost, path.sign) if value > path.value else path

    def without_touched(self, positions: NDArray, reach: float) -> None:
        """Take from the paths what they owed to pixels that were taken out of the frames.

        Paths of a sign are found anew where too few owed nothing for a tail to be told from them.

        Parameters
        ----------
        positions : array, shape (T, 2)
            Of the path around which they were.
        reach : float
            Pixels along either axis from there within which they were.
        """
        self._are_new.clear()
        # The one whose table is at hand comes first.
        for sign in sorted(self._by_sign, key=lambda sign: sign != self._searched):
            known = self._by_sign[sign]
            left = self._left(sign, positions, reach + self._sees_px)
            untouched = sum(path.value > UNTOUCHED * before.value
                            for path, before in zip(left, known, strict=True))
            self._by_sign[sign] = left if untouched >= MOST_PATHS else self._found(sign)

    def renew(self, sign: int) -> None:
        """Find the paths of a sign anew: beside one that is taken there may be others."""
        if sign not in self._are_new:
            self._by_sign[sign] = self._found(sign)

    def _of_sign(self, sign: int) -> NDArray:
        """Return frames in which targets of a sign are bright."""
        return self.frames if sign > 0 else -self.frames

    def _left(self, sign: int, positions: NDArray, reach: float) -> list[SignedPath]:
        """Return the paths of a sign with their values in the present frames.

        These differ from those before within reach of the positions alone.
        """
        frames = self._of_sign(sign)
        return [replace(path, value=self._refiner.value(frames, path.positions, path.cost))
                if (np.abs(path.positions - positions).max(axis=1) < reach).any() else path
                for path in self._by_sign[sign]]

    def _found(self, sign: int) -> list[SignedPath]:
        """Return the strongest paths of a sign in the present frames."""
        levels = [0.0]
        if sign != self._searched:
            self._search.forget()
        elif self._least.get(sign, 0.0) > 0:
            # Only states that may pass the weakest are then computed anew.
            levels = [self._least[sign], 0.0]
        self._searched = sign
        self._are_new.add(sign)
        for level in levels:
            _, found = self._search.best_paths(
                self._of_sign(sign), level, self._separation, N_PATHS)
            if len(found) >= ENOUGH:
                break
        self._least[sign] = found[-1].value if len(found) == N_PATHS else level
        return [SignedPath(path.positions, path.value, path.cost, sign) for path in found]
