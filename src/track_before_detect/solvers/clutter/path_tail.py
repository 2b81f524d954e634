"""The tail of the strongest paths that are no target."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

# Most paths that the tail is fitted to: few, because clutter differs further in.
MOST_PATHS = 40
# Places at which a path can be, for each path of the tail.
PLACES = 8


@dataclass(frozen=True)
class PathTail:
    """Squared statistics of separate paths, exponential beyond a start.

    The square of a statistic has the tail nearest to an exponential, as in noise.

    Attributes
    ----------
    start, scale : float
        Square at which the tail begins, and mean excess over it of the paths beyond.
    count : int
        Number of paths beyond.
    """

    start: float
    scale: float
    count: int

    def threshold(self, rate: float, share: float = 1.0) -> float:
        """Return what the largest statistic, which is none of these, passes with a probability.

        The scale is known from as many excesses as there are; an excess over their mean is Pareto
        distributed, which adds what they do not tell, and the largest is that of one more.

        Parameters
        ----------
        rate : float
            The probability.
        share : float
            Of the frame, in which it is to hold.
        """
        beyond = ((self.count + 1) * share / rate) ** (1 / self.count) - 1
        return math.sqrt(self.start + self.scale * self.count * max(beyond, 0.0))


def path_tail(statistics: ArrayLike, n_places: float) -> PathTail:
    """Return the tail of the strongest separate paths of a batch.

    Parameters
    ----------
    statistics : array
        Of separate paths, all beyond some value; at least two.
    n_places : float
        Separate places at which a path can be.
    """
    ordered = np.sort(np.asarray(statistics, float) ** 2)[::-1]
    count = int(np.clip(round(n_places / PLACES), 2, min(MOST_PATHS, len(ordered) - 1)))
    start = float(ordered[count])
    return PathTail(start, float(np.mean(ordered[:count])) - start, count)
