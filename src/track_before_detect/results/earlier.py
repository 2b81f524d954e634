"""What an earlier run has left in the folder of a result."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import json
from pathlib import Path
from typing import Any

from track_before_detect.results.film import FILMS
from track_before_detect.results.formats import FORMATS

SUMMARY, OVERLAY, REJECTED = 'summary.json', 'overlay.png', 'rejected.csv'
_OWN = {OVERLAY, REJECTED, *(one.file for one in FORMATS.values())}


@contextmanager
def removing_earlier(output: Path, summary: Mapping[str, Any]) -> Iterator[None]:
    """Remove what an earlier run has written to a folder and the block does not write again.

    Nothing is removed where the block ends with an error, nor what the summary of the earlier run
    does not name, nor the recording that is searched.

    Parameters
    ----------
    output : Path
    summary : mapping
        Of this run, with the ``path`` of its recording.
    """
    before = {file: _state(file) for file in _written_before(output) if file.is_file()}
    yield
    searched = Path(summary['path']).resolve()
    for file, state in before.items():
        if _state(file) == state and file.resolve() != searched:
            file.unlink()


def _written_before(output: Path) -> list[Path]:
    """Return the files that the summary in a folder names, of those that a result may have."""
    try:
        names = json.loads((output / SUMMARY).read_text(encoding='utf-8'))['files']
    except (OSError, ValueError, KeyError, TypeError):
        # None, or not one of ours.
        return []
    return [output / name for name in (names if isinstance(names, list) else [])
            if isinstance(name, str) and (
                name in _OWN or Path(name).name == name and Path(name).suffix in FILMS)]


def _state(file: Path) -> tuple[int, int]:
    """Return what tells whether a file is still the same; one that was replaced is another."""
    state = file.stat()
    return state.st_ino, state.st_mtime_ns
