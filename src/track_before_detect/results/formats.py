"""The files that trajectories can be written to, by the name of their format."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from track_before_detect.errors import named
from track_before_detect.recordings.result_files import write_trajectories_csv
from track_before_detect.results.boxes import write_coco, write_mot
from track_before_detect.results.found import Found
from track_before_detect.results.json_lines import write_json_lines
from track_before_detect.results.parquet import write_parquet


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes
    ----------
    file : str
        Its name.
    write : callable
        Writes it to a path.
    package, extra : str
        Needed for it, and how it is installed; empty where nothing is.
    """

    file: str
    write: Callable[[Path, Found], None]
    package: str = ''
    extra: str = ''


FORMATS = {
    'csv': Format('trajectories.csv', lambda path, found: write_trajectories_csv(
        path, found.result.trajectories)),
    'json': Format('trajectories.jsonl', write_json_lines),
    'mot': Format('mot.txt', write_mot),
    'coco': Format('coco.json', write_coco),
    'parquet': Format('trajectories.parquet', write_parquet, 'pyarrow', 'parquet'),
}


def formats_named(text: str) -> tuple[Format, ...]:
    """Return the formats of a list with commas, the CSV always first."""
    names = [name for part in text.split(',') if (name := part.strip())]
    return tuple(dict.fromkeys(named('format', name, FORMATS) for name in ('csv', *names)))
