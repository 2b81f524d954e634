"""What a search leaves: trajectories as CSV, its summary as JSON, each whole or not at all."""

from collections.abc import Iterable, Mapping
import csv
import json
import math
import os
from typing import Any

import numpy as np

from track_before_detect.atomic_files import atomic_path
from track_before_detect.types import Trajectory

CSV_COLUMNS = ('trajectory_id', 'frame', 'stamp_s', 'x_px', 'y_px', 'vx_px_s', 'vy_px_s',
               'amplitude', 'snr', 'statistic', 'var_x_px2', 'cov_xy_px2', 'var_y_px2')


def write_trajectories_csv(path: str | os.PathLike, trajectories: Iterable[Trajectory],
                           with_reason: bool = False) -> None:
    """Write one row per trajectory and frame in which it is present.

    Positions are in pixels of the original frames, stamps in seconds with microseconds. ``snr``
    and ``statistic`` belong to the trajectory as a whole. A complex amplitude is given by its
    magnitude; a velocity or covariance that is not known is left empty. Without trajectories the
    file holds the header alone.

    Parameters
    ----------
    path : path
    trajectories : iterable of Trajectory
    with_reason : bool
        Adds a last column, why each is rejected.
    """
    with atomic_path(path) as partial, open(partial, 'w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(CSV_COLUMNS + ('reason',) * with_reason)
        for trajectory in trajectories:
            for k in np.flatnonzero(np.isfinite(trajectory.positions).all(axis=1)):
                writer.writerow([
                    int(trajectory.id), int(trajectory.frame_indices[k]),
                    f'{trajectory.stamps[k]:.6f}',
                    *(_fixed(value, 3) for value in trajectory.positions[k]),
                    *(_fixed(value, 4) for value in trajectory.velocity[k]),
                    _significant(abs(trajectory.amplitudes[k])),
                    _significant(trajectory.snr), _significant(trajectory.statistic),
                    *map(_significant, trajectory.covariance[k][np.triu_indices(2)]),
                    *[trajectory.reason] * with_reason])


def write_summary_json(path: str | os.PathLike, mapping: Mapping[str, Any]) -> None:
    """Write a mapping as JSON; numbers that are not finite become null.

    Parameters
    ----------
    path : path
    mapping : mapping
        Values may be nested and may be NumPy scalars and arrays.
    """
    text = json.dumps(_plain(mapping), indent=2, allow_nan=False, ensure_ascii=False)
    with atomic_path(path) as partial:
        partial.write_text(text + '\n', encoding='utf-8')


def _fixed(value: float, digits: int) -> str:
    return f'{value:.{digits}f}' if math.isfinite(value) else ''


def _significant(value: float) -> str:
    return f'{value:.6g}' if math.isfinite(value) else ''


def _plain(value: Any) -> Any:
    """Return ``value`` in types JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, bool, int)):
        return value
    return str(value)
