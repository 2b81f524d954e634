"""Many recordings, each searched by one of many workers."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
import time
from typing import Any, TextIO

from track_before_detect.cli.arguments.results import wanted_files
from track_before_detect.cli.console import Progress
from track_before_detect.cli.detect import exit_code, folders_of, outcome_of, said_of
from track_before_detect.options import describe
from track_before_detect.recordings.result_files import plain
from track_before_detect.runs.kept_results import KeptResults
from track_before_detect.runs.runner import Item, Runner
from track_before_detect.runs.workers import Workers
from track_before_detect.types import Count
from track_before_detect.types import Progress as Told

# What is finished, beside the folders of results.
FINISHED = 'finished.jsonl'
# The arguments that decide what is found and written.
_DECIDING = ('topic', 'fps', 'preset', 'explain', 'formats', 'json', 'video', 'no_overlay')


def search_on_workers(paths: Sequence[Path], arguments: Namespace, told: Mapping[str, Any],
                      words: TextIO) -> int:
    """Search each recording on a worker, but for those done before; return the exit code."""
    workers = Workers(arguments.jobs, 'dask',
                      None if arguments.scheduler == 'local' else arguments.scheduler)
    folders = folders_of(paths, arguments)
    options = _with_whole_names(told)
    decided = {name: getattr(arguments, name) for name in _DECIDING}
    files = [Path(value) for value in options.values() if _is_file(value)]
    items = [{
        'input': str(path.absolute()), 'output': str(output.absolute()), 'options': options,
        'arguments': decided, 'files': [_state_of(file) for file in (path, *files)],
    } for path, output in zip(paths, folders, strict=True)]
    codes = []
    with Progress.asked_for(arguments, every=True) as progress:
        runner = Runner(_with_estimate(progress, len(paths)), workers,
                        KeptResults(Path(arguments.output) / FINISHED))
        with closing(runner.each(searched, items, 'searching', _is_there)) as outcomes:
            for number, outcome in outcomes:
                codes.append(said_of(paths[number], folders[number], outcome, words))
    return exit_code(codes)


def searched(item: Item) -> dict[str, Any]:
    """Search the recording of an item and write its files; see :func:`outcome_of`."""
    arguments = Namespace(**item['arguments'], quiet=True, verbose=False)
    return outcome_of(Path(item['input']), Path(item['output']), arguments, item['options'],
                      wanted_files(arguments))


def _is_there(item: Item, outcome: Mapping[str, Any]) -> bool:
    """Return whether a recording was searched, and its files are still there."""
    return 'error' not in outcome and all(
        (Path(item['output']) / name).exists() for name in outcome['written'])


def _with_whole_names(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return options that JSON can hold, and that mean the same in any folder."""
    arrays = {option['name'] for option in describe() if option['kind'] == 'array'}
    return plain({name: str(Path(value).absolute())
                  if name in arrays and isinstance(value, str) else value
                  for name, value in told.items()})


def _is_file(value: Any) -> bool:
    return isinstance(value, str) and Path(value).is_absolute()


def _state_of(path: Path) -> list[int]:
    """Return what tells whether a file, or those of a folder, are still the same."""
    states = [file.stat() for file in sorted(path.rglob('*') if path.is_dir() else [path])
              if file.exists()]
    return [len(states), sum(one.st_size for one in states),
            max((one.st_mtime_ns for one in states), default=0)]


def _with_estimate(progress: Told, total: int) -> Told:
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
