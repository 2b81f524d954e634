"""What a search leaves: trajectories as CSV and its summary as JSON, written and read again."""

from collections.abc import Iterable, Iterator, Mapping
import csv
import json
import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.atomic_files import atomic_path
from track_before_detect.errors import DataError
from track_before_detect.types import Trajectory

# How each number of a row is written as text.
_COLUMNS = {'trajectory_id': 'd', 'frame': 'd', 'stamp_s': '.6f', 'x_px': '.3f', 'y_px': '.3f',
            'vx_px_s': '.4f', 'vy_px_s': '.4f', 'amplitude': '.6g', 'snr': '.6g',
            'statistic': '.6g', 'var_x_px2': '.6g', 'cov_xy_px2': '.6g', 'var_y_px2': '.6g'}
CSV_COLUMNS = tuple(_COLUMNS)


def presences(trajectories: Iterable[Trajectory]) -> Iterator[tuple[Trajectory, int]]:
    """Yield each trajectory with each of its rows in which it is present."""
    for trajectory in trajectories:
        for k in np.flatnonzero(np.isfinite(trajectory.positions).all(axis=1)):
            yield trajectory, int(k)


def row_of(trajectory: Trajectory, k: int) -> tuple[float, ...]:
    """Return the numbers of a row, in the order of the columns; NaN where not known."""
    return (int(trajectory.id), int(trajectory.frame_indices[k]), float(trajectory.stamps[k]),
            *map(float, trajectory.positions[k]), *map(float, trajectory.velocity[k]),
            float(abs(trajectory.amplitudes[k])), trajectory.snr, trajectory.statistic,
            *map(float, trajectory.covariance[k][np.triu_indices(2)]))


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
        for trajectory, k in presences(trajectories):
            writer.writerow([
                *(f'{value:{form}}' if math.isfinite(value) else ''
                  for value, form in zip(row_of(trajectory, k), _COLUMNS.values(), strict=True)),
                *[trajectory.reason] * with_reason])


def read_trajectories_csv(path: str | os.PathLike) -> list[Trajectory]:
    """Read trajectories that :func:`write_trajectories_csv` has written.

    Parameters
    ----------
    path : path

    Returns
    -------
    list of Trajectory
        With a row for each frame in which they are present; amplitudes are real.

    Raises
    ------
    DataError
        When there is no such file, or it holds something else.
    """
    rows: dict[int, list[dict[str, str]]] = {}
    try:
        with open(path, newline='', encoding='utf-8') as file:
            reader = csv.DictReader(file)
            if missing := set(CSV_COLUMNS) - set(reader.fieldnames or ()):
                raise ValueError(f'the header names no {", ".join(sorted(missing))}')
            for row in reader:
                rows.setdefault(int(row['trajectory_id']), []).append(row)
        return [_trajectory_of(number, of_one) for number, of_one in rows.items()]
    except OSError as error:
        raise DataError(f'{path} cannot be read: {error.strerror}') from error
    except (ValueError, TypeError, csv.Error) as error:
        raise DataError(f'{path} must hold the trajectories of a search: {error}') from error


def _trajectory_of(number: int, rows: list[dict[str, str]]) -> Trajectory:
    """Return a trajectory from its rows; what is empty is NaN."""
    def column(name: str) -> NDArray[np.float64]:
        return np.array([float(row[name] or 'nan') for row in rows])

    var_x, cov_xy, var_y = map(column, ('var_x_px2', 'cov_xy_px2', 'var_y_px2'))
    return Trajectory(
        number, np.column_stack([column('x_px'), column('y_px')]), column('amplitude'),
        np.column_stack([column('vx_px_s'), column('vy_px_s')]), column('stamp_s'),
        column('frame').astype(np.int64), float(rows[0]['statistic']), float(rows[0]['snr']),
        rows[0].get('reason') or '',
        np.stack([var_x, cov_xy, cov_xy, var_y], axis=-1).reshape(-1, 2, 2))


def write_summary_json(path: str | os.PathLike, mapping: Mapping[str, Any]) -> None:
    """Write a mapping as JSON; numbers that are not finite become null.

    Parameters
    ----------
    path : path
    mapping : mapping
        Values may be nested and may be NumPy scalars and arrays.
    """
    text = json.dumps(plain(mapping), indent=2, allow_nan=False, ensure_ascii=False)
    with atomic_path(path) as partial:
        partial.write_text(text + '\n', encoding='utf-8')


def plain(value: Any) -> Any:
    """Return ``value`` in types JSON knows; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, bool, int)):
        return value
    return str(value)
