"""The methods of Fu et al. 2022 as the paper runs them: without a threshold.

:func:`single_target` gives one pixel in each frame (section 4.1 of the paper),
:func:`several_targets` a given number of trajectories (Algorithm 2)::

    positions = single_target(frames, 'mff_dpr', v_max=1)           # (T, 2), x and y
    found = several_targets(frames, 'mff_dpr', v_max=1, n_targets=3)
    found[0].positions, found[0].score                              # (T, 2), NaN where absent

Both take *observations*, one value for each pixel and frame that a target raises. The targets of
the paper are points, one pixel wide, so there the frames are the observations. A target that the
point spread function spreads over several pixels is seen best in the matched filter statistic,
which has the noise of one pixel and the whole of the target; sums of raw pixels would leave most
of it aside. So the detectors ``cfo_dp`` to ``mff_dpr`` accumulate that statistic.
"""

from collections.abc import Callable, Iterator
import dataclasses
import itertools

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.solvers.ring.crossings import with_crossings_resolved
from track_before_detect.solvers.ring.linking import best_trajectory, LinkedTrajectory
from track_before_detect.solvers.ring.merit_functions import merit_functions

Observe = Callable[[NDArray], NDArray]
# Around a found point target, as in the paper, see :func:`fill`.
FILLED_POINT_PX = 1


def single_target(observations: NDArray, method: str, v_max: int,
                  n_threads: int = 1) -> NDArray[np.int64]:
    """Return the pixel (x, y) of the largest merit function in each frame, shape (T, 2).

    Parameters
    ----------
    observations, method, v_max, n_threads
        As of :func:`merit_functions`.
    """
    merit = merit_functions(observations, method, v_max, n_threads)
    flat = merit.reshape(len(merit), -1).argmax(axis=1)
    return np.stack([flat % merit.shape[2], flat // merit.shape[2]], axis=1)


def several_targets(frames: NDArray, method: str, v_max: int,
                    n_targets: int) -> list[LinkedTrajectory]:
    """Return the trajectories of a known number of point targets (Algorithm 2).

    Parameters
    ----------
    frames, method, v_max
        As of :func:`single_target`.
    n_targets : int
        Rounds that are made, each with at most one trajectory.

    Returns
    -------
    list of LinkedTrajectory
        In the order found, crossings resolved; fewer than ``n_targets`` where a round finds no two
        coordinates that go together.
    """
    if n_targets < 1:
        raise ParameterError(f'n_targets must be at least 1, got {n_targets}')
    rounds = found_one_by_one(frames, method, v_max, np.asarray, FILLED_POINT_PX)
    found = [trajectory for trajectory, _ in itertools.islice(rounds, n_targets)]
    regular = with_crossings_resolved([trajectory.positions for trajectory in found])
    return [dataclasses.replace(trajectory, positions=positions)
            for trajectory, positions in zip(found, regular, strict=True)]


def found_one_by_one(frames: NDArray, method: str, v_max: int, observe: Observe, fill_radius: int,
                     n_threads: int = 1) -> Iterator[tuple[LinkedTrajectory, NDArray[np.float64]]]:
    """Go through the rounds of Algorithm 2 (Steps 1-4) for as long as they find anything new.

    A round that takes nothing out of the frames is the last: the next would find the same.

    Parameters
    ----------
    frames, method, v_max, n_threads
        As of :func:`single_target`; masked pixels are NaN.
    observe : callable
        Returns the observations (T, H, W) of what is left of the frames.
    fill_radius : int
        See :func:`fill`.

    Yields
    ------
    trajectory : LinkedTrajectory
        The best of its round.
    seen : array, shape (T,)
        The observations at its positions, less what earlier rounds took; NaN where absent.
    """
    left = np.array(frames, np.float32)
    while True:
        observations = observe(left)
        coordinates = single_target(observations, method, v_max, n_threads)
        trajectory = best_trajectory(coordinates, v_max, left.shape[1:])
        if trajectory is None:
            return
        present = np.flatnonzero(np.isfinite(trajectory.positions[:, 0]))
        x, y = trajectory.positions[present].astype(int).T
        seen = np.full(len(left), np.nan)
        seen[present] = observations[present, y, x]
        yield trajectory, seen
        if not fill(left, trajectory.positions, fill_radius):
            return


def fill(frames: NDArray, positions: NDArray, radius: int) -> bool:
    """Replace the pixels around a trajectory by the median around each of them (Eq. 11).

    Parameters
    ----------
    frames : float array, shape (T, H, W)
        Changed in place; NaN where masked.
    positions : array, shape (T, 2)
        x and y in whole pixels; NaN where absent.
    radius : int
        Half a side, less half a pixel, both of the square that is filled and of the squares that
        medians are taken over, as far as these are inside the frame. It is 1 in the paper; a
        target that covers more pixels needs more, or its rim is found as another target.

    Returns
    -------
    bool
        Whether any pixel changed.
    """
    _, height, width = frames.shape
    present = np.flatnonzero(np.isfinite(positions[:, 0]))
    centre_x, centre_y = positions[present].astype(int).T
    reach = np.arange(-2 * radius, 2 * radius + 1)
    rows = centre_y[:, None, None] + reach[:, None]
    columns = centre_x[:, None, None] + reach
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    patches = np.where(inside, frames[present[:, None, None], rows.clip(0, height - 1),
                                      columns.clip(0, width - 1)], np.nan)
    side = 2 * radius + 1
    windows = sliding_window_view(patches, (side, side), (1, 2))
    # What is masked or outside the frame is sorted to the end.
    ordered = np.sort(windows.reshape(len(present), side, side, side * side), axis=3)
    count = np.isfinite(ordered).sum(axis=3, keepdims=True)
    low, high = (np.take_along_axis(ordered, middle.clip(0), axis=3)[..., 0]
                 for middle in ((count - 1) // 2, count // 2))
    filled = slice(radius, radius + side)
    t, i, j = np.nonzero(np.isfinite(patches[:, filled, filled]))
    places = present[t], rows[t, i + radius, 0], columns[t, 0, j + radius]
    medians = ((low + high)[t, i, j] / 2).astype(frames.dtype)
    changed = bool(np.any(frames[places] != medians))
    frames[places] = medians
    return changed
