"""What is told to workers, and tells whether what they did before still holds."""

from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
import time
from typing import Any

from track_before_detect.options import describe
from track_before_detect.recordings.result_files import plain
from track_before_detect.runs.workers import Workers
from track_before_detect.types import Count, Progress

# What is finished, beside the results.
FINISHED = 'finished.jsonl'


def workers_of(arguments: Namespace) -> Workers:
    """Return who is asked to search."""
    return Workers(arguments.jobs, 'dask',
                   None if arguments.scheduler == 'local' else arguments.scheduler)


def with_whole_names(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return options that JSON can hold, and that mean the same in any folder."""
    arrays = {option['name'] for option in describe() if option['kind'] == 'array'}
    return plain({name: str(Path(str(value)).absolute())
                  if name in arrays and value is not None else value
                  for name, value in told.items()})


def states_of(path: Path, options: Mapping[str, Any]) -> list[list[int]]:
    """Return what tells whether a recording, and the files of options, are still the same."""
    return [_state_of(file) for file in (path, *(
        Path(value) for value in options.values() if _is_file(value)))]


def _is_file(value: Any) -> bool:
    return isinstance(value, str) and Path(value).is_absolute()


def _state_of(path: Path) -> list[int]:
    """Return what tells whether a file, or those of a folder, are still the same."""
    states = [file.stat() for file in sorted(path.rglob('*') if path.is_dir() else [path])
              if file.exists()]
    return [len(states), sum(one.st_size for one in states),
            max((one.st_mtime_ns for one in states), default=0)]


def with_estimate(progress: Progress, total: int) -> Progress:
    """Return a progress that also says how many there are and how long it is going to take."""
    began: list[tuple[float, float]] = []

    def tell(label: str, share: float) -> None:
        now = time.perf_counter()
        began.append((now, share))
        words = f'{round(share * total)} of {total}'
        gone, done = now - began[0][0], share - began[0][1]
        if done > 0 and share < 1:
            words += f', about {gone * (1 - share) / done:.0f} s to go'
        progress(label, Count(share, words))

    return tell
