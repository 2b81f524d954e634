"""A folder of a result, read again."""

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.recording import Recording
from track_before_detect.recordings.result_files import read_trajectories_csv
from track_before_detect.types import Trajectory

_SUMMARY, _TRAJECTORIES = 'summary.json', 'trajectories.csv'


@dataclass(frozen=True)
class Opened:
    """How a recording was opened, so that it can be again.

    Attributes
    ----------
    path : Path
    topic : str or None
        Of a bag.
    fps : float or None
        In place of its stamps.
    """

    path: Path
    topic: str | None = None
    fps: float | None = None

    def open(self) -> Recording:
        """Open it; errors are those of :func:`open_recording`."""
        return open_recording(self.path, self.topic, self.fps)

    def as_mapping(self) -> dict[str, Any]:
        """Return what summary.json says of it."""
        return {'path': str(self.path.absolute()), 'topic': self.topic, 'fps': self.fps}


def is_result(path: Path) -> bool:
    """Return whether a search has written its results to a folder."""
    return all((path / name).is_file() for name in (_SUMMARY, _TRAJECTORIES))


def read_result(folder: Path) -> tuple[Opened, list[Trajectory]]:
    """Return which recording was searched, and what was found; DataError for another folder."""
    file = folder / _SUMMARY
    try:
        summary = json.loads(file.read_text(encoding='utf-8'))
        opened = Opened(Path(summary['path']), summary['topic'], summary['fps'])
    except OSError as error:
        raise DataError(f'{file} cannot be read: {error.strerror}') from error
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f'{file} must be the summary of a search with path, topic and fps of its '
                        f'recording, got another: {type(error).__name__}: {error}') from error
    return opened, read_trajectories_csv(folder / _TRAJECTORIES)
