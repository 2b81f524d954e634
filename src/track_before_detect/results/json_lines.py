"""Trajectories as lines of JSON, each a feature in the form of GeoJSON."""

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

import numpy as np

from track_before_detect.recordings.result_files import plain
from track_before_detect.results.found import Found
from track_before_detect.types import Trajectory


def json_lines(found: Found) -> Iterator[str]:
    """Yield a line for each trajectory: a feature whose coordinates are pixels, y downwards."""
    for trajectory in found.result.trajectories:
        feature = _feature(found.recording.name, trajectory, found.result.threshold)
        yield json.dumps(plain(feature), allow_nan=False) + '\n'


def write_json_lines(path: Path, found: Found) -> None:
    """Write a line for each trajectory."""
    path.write_text(''.join(json_lines(found)), encoding='utf-8')


def _feature(name: str, trajectory: Trajectory, threshold: float) -> dict[str, Any]:
    """Return a trajectory over the frames in which it is present."""
    present = np.isfinite(trajectory.positions).all(axis=1)
    places = np.round(trajectory.positions[present], 3)
    return {
        'type': 'Feature',
        'id': trajectory.id,
        # A line has two ends; what is seen once has none.
        'geometry': {'type': 'LineString', 'coordinates': places} if len(places) > 1 else
                    {'type': 'Point', 'coordinates': places[0]},
        'properties': {
            'input': name,
            'snr': trajectory.snr,
            'statistic': trajectory.statistic,
            'threshold': threshold,
            'frames': trajectory.frame_indices[present],
            'stamps_s': trajectory.stamps[present],
            'velocity_px_s': np.round(trajectory.velocity[present], 4),
            'amplitude': np.abs(trajectory.amplitudes[present]),
            'covariance_px2': trajectory.covariance[present],
        },
    }
