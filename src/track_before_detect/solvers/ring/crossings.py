"""Which trajectory is which after two met (Fu et al. 2022, Algorithm 2, Step 5)."""

from collections.abc import Sequence
import itertools

import numpy as np
from numpy.typing import NDArray

# Trajectories that stay this far apart did not meet (Eq. 12), in pixels.
SEPARATION_PX = 5.0
# Frames on either side of a crossing that straight lines are fitted to (T_L of Eq. 14).
FITTED_FRAMES = 10


def with_crossings_resolved(trajectories: Sequence[NDArray]) -> list[NDArray[np.float64]]:
    """Return trajectories that go on as straight as they can where two of them met.

    Parameters
    ----------
    trajectories : sequence of arrays, shape (T, K)
        x, y and whatever else goes with them, NaN where absent.

    Returns
    -------
    list of arrays, shape (T, K)
        Of each pair that met, both halves of both trajectories, put together in the one of two
        ways in which straight lines through one half predict the other better (Eq. 14). A pair
        that is not seen in two common frames on either side is left as it is.
    """
    regular = [np.array(positions, float) for positions in trajectories]
    for one, other in itertools.combinations(regular, 2):
        at = _meeting(one, other)
        if at is not None and _swapped_fits_better(one, other, at):
            rest = one[at + 1:].copy()
            one[at + 1:] = other[at + 1:]
            other[at + 1:] = rest
    return regular


def _meeting(one: NDArray, other: NDArray) -> int | None:
    """Return the frame in which two trajectories are closest; None where they never meet."""
    distances = np.linalg.norm(one[:, :2] - other[:, :2], axis=1)
    if np.isnan(distances).all():
        return None
    at = int(np.nanargmin(distances))
    return at if distances[at] < SEPARATION_PX else None


def _swapped_fits_better(one: NDArray, other: NDArray, at: int) -> bool:
    """Return whether E1 < E2 of Eq. 14 fails, the sums taken over frames that both are in."""
    n_frames = len(one)
    away = np.arange(1, min(FITTED_FRAMES, at, n_frames - 1 - at) + 1)
    both = np.isfinite(one[:, 0]) & np.isfinite(other[:, 0])
    away = away[both[at - away] & both[at + away]]
    if len(away) < 2:
        return False
    kept = swapped = 0.0
    for side in (-1, 1):
        halves = [positions[at + side * away, :2] for positions in (one, other)]
        predicted = [_line(away, positions[at - side * away, :2], -away)
                     for positions in (one, other)]
        kept += sum(np.sum((halves[i] - predicted[i])**2) for i in (0, 1))
        swapped += sum(np.sum((halves[i] - predicted[1 - i])**2) for i in (0, 1))
    return not kept < swapped


def _line(times: NDArray, positions: NDArray, at: NDArray) -> NDArray[np.float64]:
    """Return the straight line fitted to positions at times, at other times."""
    design = np.stack([np.ones(len(times)), times], axis=1)
    coefficients = np.linalg.lstsq(design, positions, rcond=None)[0]
    return np.stack([np.ones(len(at)), at], axis=1) @ coefficients
