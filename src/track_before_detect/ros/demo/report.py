"""The tables of the demo: what was found, beside what was there."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from track_before_detect.cli.console import (
    first_and_last,
    position_cell,
    table,
    trajectory_cells,
    trajectory_header,
)
from track_before_detect.types import Trajectory

NEAR_PX = 3.0

# Distances of a trajectory to a target in the frames they share, by the ids of both.
Errors = dict[tuple[int, int], NDArray[np.float64]]


def report(trajectories: Sequence[Trajectory], truth: NDArray | None) -> str:
    """Return tables of the trajectories found and of the true targets.

    Parameters
    ----------
    trajectories : sequence of Trajectory
        NaN in frames in which they are absent.
    truth : array, shape (N, 4), or None
        Rows [frame, target, x, y].
    """
    errors = {(trajectory.id, target): error for trajectory in trajectories
              for target, error in _errors(trajectory, truth).items()}
    return '\n\n'.join(part for part in (
        _found_table(trajectories, truth, errors), _truth_table(trajectories, truth, errors))
        if part)


def _errors(trajectory: Trajectory, truth: NDArray | None) -> dict[int, NDArray[np.float64]]:
    """Return the distances to each true target in the frames they share."""
    errors: dict[int, NDArray[np.float64]] = {}
    if truth is None:
        return errors
    present = np.isfinite(trajectory.positions[:, 0])
    for target in np.unique(truth[:, 1]):
        rows = truth[truth[:, 1] == target]
        _, ours, theirs = np.intersect1d(
            trajectory.frame_indices[present], rows[:, 0], return_indices=True)
        if len(ours):
            errors[int(target)] = np.hypot(
                *(trajectory.positions[present][ours] - rows[theirs, 2:]).T)
    return errors


def _found_table(trajectories: Sequence[Trajectory], truth: NDArray | None,
                 errors: Errors) -> str:
    if not trajectories:
        return 'no trajectory found'
    rows = [[*trajectory_header(stamps_known=True),
             *([] if truth is None else ['nearest target', 'mean error [px]'])]]
    for trajectory in trajectories:
        row = trajectory_cells(trajectory)
        if truth is not None:
            near = {target: distances.mean() for (identity, target), distances in errors.items()
                    if identity == trajectory.id}
            nearest = min(near, key=lambda target: near[target], default=None)
            row += ['-', '-'] if nearest is None else [str(nearest), f'{near[nearest]:.2f}']
        rows.append(row)
    return 'trajectories found\n' + table(rows)


def _truth_table(trajectories: Sequence[Trajectory], truth: NDArray | None,
                 errors: Errors) -> str:
    if truth is None:
        return ''
    rows = [['target', 'frames', 'first x, y [px]', 'last x, y [px]',
             f'frames within {NEAR_PX:g} px', 'by ids']]
    for target in np.unique(truth[:, 1]).astype(int):
        places = truth[truth[:, 1] == target]
        followed: set[int] = set()
        by_ids = []
        for trajectory in trajectories:
            distances = errors.get((trajectory.id, target))
            if distances is None:
                continue
            present = np.isfinite(trajectory.positions[:, 0])
            shared = np.intersect1d(trajectory.frame_indices[present], places[:, 0])
            near = shared[distances <= NEAR_PX].astype(int).tolist()
            followed.update(near)
            by_ids += [str(trajectory.id)] if near else []
        rows.append([str(target), first_and_last(places[:, 0].astype(int)),
                     position_cell(places[0, 2:]), position_cell(places[-1, 2:]),
                     f'{len(followed)} of {len(places)}',
                     ', '.join(by_ids) or '-'])
    return 'true targets\n' + table(rows)
