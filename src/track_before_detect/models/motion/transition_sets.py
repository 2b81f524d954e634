"""Transition sets of first-order dynamic programming, whole or by direction.

From a pixel of one frame a target may have come from any pixel of the frame before that is at most
the largest speed away in x and in y (q = 9 pixels at one pixel per frame, 25 at two). Split by
direction, each part holds the steps that a target makes whose direction is within one sector: a
velocity between whole pixels makes all four steps around it. With four sectors these are the four
quadrants of Guo et al. 2018 (Eq. 11-12, Fig. 2, section 4.2): neighbouring parts share the pixels
on their border and all of them the pixel itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

# Sectors that overlap by less than this angle only touch.
_TOUCHING = 1e-9


@dataclass(frozen=True)
class TransitionSets:
    """Where a target may have been one frame before, for each frame of a batch.

    Attributes
    ----------
    rows : array of int32, shape (R, 3)
        dy, first dx and last dx of each row of pixels of each set; rows of one set with the same
        dx stand together.
    row_first : array of int32, shape (S + 1,)
        First row of each set.
    sets : array of int32, shape (T,)
        Which set leads to each frame; that of the first frame is not used.
    """

    rows: NDArray[np.int32]
    row_first: NDArray[np.int32]
    sets: NDArray[np.int32]

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Number of predecessors in each set."""
        counts = self.rows[:, 2] - self.rows[:, 1] + 1
        return np.add.reduceat(counts, self.row_first[:-1]).astype(np.int64)

    def pixels(self, number: int) -> set[tuple[int, int]]:
        """Return the predecessors (dx, dy) of a set."""
        rows = self.rows[self.row_first[number]:self.row_first[number + 1]].tolist()
        return {(dx, dy) for dy, first, last in rows for dx in range(first, last + 1)}


def transition_sets(reaches: Sequence[int] | NDArray, direction: int = 0,
                    n_directions: int = 1) -> TransitionSets:
    """Return the transition sets of one direction.

    Parameters
    ----------
    reaches : sequence of int
        Largest step in x and in y, in pixels, to each frame from the one before; the first is not
        used.
    direction : int
        Number of the sector, counted from +x towards +y.
    n_directions : int
        Number of sectors; one holds everything.
    """
    numbers: dict[int, int] = {}
    rows: list[tuple[int, int, int]] = []
    row_first = [0]
    sets = []
    for reach in np.asarray(reaches, int).tolist():
        if reach not in numbers:
            numbers[reach] = len(numbers)
            rows.extend(_rows_of(reach, direction, n_directions))
            row_first.append(len(rows))
        sets.append(numbers[reach])
    return TransitionSets(np.array(rows, np.int32), np.array(row_first, np.int32),
                          np.array(sets, np.int32))


def directional_sets(reaches: Sequence[int] | NDArray,
                     n_directions: int) -> list[TransitionSets]:
    """Return the transition sets of all directions, without those that another one contains.

    At one pixel per frame, for example, no more than the four quadrants differ.
    """
    parts = [transition_sets(reaches, direction, n_directions)
             for direction in range(n_directions)]
    pixels = [[part.pixels(number) for number in range(len(part.row_first) - 1)]
              for part in parts]
    kept: list[int] = []
    for i, mine in enumerate(pixels):
        def within(j: int, mine: list[set[tuple[int, int]]] = mine) -> bool:
            return all(a <= b for a, b in zip(mine, pixels[j], strict=True))

        later = any(within(j) and pixels[j] != mine for j in range(i + 1, len(parts)))
        if not later and not any(within(j) for j in kept):
            kept.append(i)
    return [parts[i] for i in kept]


def _rows_of(reach: int, direction: int, n_directions: int) -> list[tuple[int, int, int]]:
    """Return dy, first dx and last dx of each row, ordered so that equal dx stand together."""
    steps: dict[int, list[int]] = {0: [0]}
    for x in range(-reach, reach):
        for y in range(-reach, reach):
            if n_directions == 1 or _in_sector(x, y, direction, n_directions):
                for dy in (y, y + 1):
                    steps.setdefault(dy, []).extend((x, x + 1))
    rows = [(dy, min(dx), max(dx)) for dy, dx in steps.items()]
    return sorted(rows, key=lambda row: (row[1:], row[0]))


def _in_sector(x: int, y: int, direction: int, n_directions: int) -> bool:
    """Whether velocities between (x, y) and (x + 1, y + 1) have directions within a sector."""
    width = 2 * math.pi / n_directions
    angles = [math.atan2(y + j, x + i) - direction * width
              for i in (0, 1) for j in (0, 1) if (x + i, y + j) != (0, 0)]
    # The square lies in one quadrant, so its angles are less than half a turn apart.
    turned = [(angle - angles[0] + math.pi) % (2 * math.pi) - math.pi for angle in angles]
    low = (angles[0] + min(turned)) % (2 * math.pi)
    high = low + max(turned) - min(turned)
    return low < width - _TOUCHING or high > 2 * math.pi + _TOUCHING
