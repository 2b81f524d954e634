"""The folder of a result: all of its files, written aside and moved to their place together."""

from collections.abc import Callable, Sequence
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from track_before_detect.atomic_files import atomic_folder
from track_before_detect.errors import TbdError
from track_before_detect.recordings.overlay import write_overlay
from track_before_detect.recordings.result_files import write_summary_json, write_trajectories_csv
from track_before_detect.results.earlier import OVERLAY, REJECTED, removing_earlier, SUMMARY
from track_before_detect.results.film import write_film
from track_before_detect.results.formats import Format
from track_before_detect.results.found import Found
from track_before_detect.results.saved import Opened
from track_before_detect.timestamps import increasing_frames
from track_before_detect.types import Progress, Trajectory


@dataclasses.dataclass(frozen=True)
class Wanted:
    """Which files there shall be, beside the summary.

    Attributes
    ----------
    formats : tuple of Format
        Of the trajectories.
    overlay : bool
        Whether to draw overlay.png.
    film : str, optional
        Name of a film to make, .mp4 or .gif.
    """

    formats: tuple[Format, ...]
    overlay: bool = True
    film: str | None = None

    def names(self, with_rejected: bool) -> list[str]:
        """Return the names of all files of a result, with that of rejected candidates or not."""
        optional = {REJECTED: with_rejected, OVERLAY: self.overlay}
        return [*(one.file for one in self.formats), SUMMARY,
                *(name for name, is_wanted in optional.items() if is_wanted),
                *([self.film] if self.film is not None else [])]


def write_folder(output: Path, found: Found, summary: dict[str, Any], wanted: Wanted,
                 rejected: Sequence[Trajectory] | None = None,
                 progress: Progress | None = None) -> tuple[list[Path], list[str]]:
    """Write the files; ``rejected`` goes to rejected.csv, if not None.

    Returns the paths of what is written, and a sentence for each picture or film that could not
    be made, without which the tables are there all the same.
    """
    recording, result = found.recording, found.result
    with removing_earlier(output, summary), atomic_folder(output) as aside:
        for one in wanted.formats:
            one.write(aside / one.file, found)
        if rejected is not None:
            write_trajectories_csv(aside / REJECTED, rejected, with_reason=True)
        write_summary_json(aside / SUMMARY, summary)
        failed = []
        if wanted.overlay:
            failed += _why_not_written(aside / OVERLAY, lambda path: _write_middle(path, found))
        if wanted.film is not None:
            failed += _why_not_written(aside / wanted.film, lambda path: write_film(
                path, recording, result.trajectories, progress))
        names = sorted(file.name for file in aside.iterdir())
    return [output / name for name in names], failed


def _write_middle(path: Path, found: Found) -> None:
    """Draw what was found over the middle frame."""
    recording = found.recording
    middle = len(recording) // 2
    write_overlay(path, recording[middle], found.result.trajectories, recording.truth,
                  f'{recording.name}, frame {middle}', middle)


def _why_not_written(path: Path, write: Callable[[Path], None]) -> list[str]:
    """Write a file; return what is wrong where that fails, with nothing left of it."""
    try:
        write(path)
    except (TbdError, OSError, MemoryError) as error:
        path.unlink(missing_ok=True)
        return [f'{path.name} cannot be written: {error or type(error).__name__}']
    return []


def summary_of(found: Found, seconds: float, version: str, opened: Opened,
               files: Sequence[str]) -> dict[str, Any]:
    """Return what summary.json says of a search that took so many seconds, and its files."""
    recording, options, result = found.recording, found.options, found.result
    interval = np.diff(recording.stamps[increasing_frames(recording.stamps)])
    return {
        'input': recording.name,
        **opened.as_mapping(),
        'n_frames': len(recording),
        'n_batches': result.n_batches,
        'height_px': recording.shape[0],
        'width_px': recording.shape[1],
        'stamps_known': recording.stamps_known,
        'median_interval_s': float(np.median(interval)) if len(interval) else None,
        'detector': options.detector,
        'options': dataclasses.asdict(options),
        'status': result.status,
        'remarks': result.remarks,
        'threshold': result.threshold,
        'threshold_source': result.threshold_source,
        'best_statistic': result.best_statistic,
        'gap': result.gap,
        'n_trajectories': len(result.trajectories),
        'seconds': round(seconds, 3),
        'version': version,
        'files': list(files),
    }
