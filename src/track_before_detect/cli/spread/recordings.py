"""Many recordings, each searched by one of many workers."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, TextIO

from track_before_detect.cli.arguments.results import wanted_files
from track_before_detect.cli.console import Progress
from track_before_detect.cli.detect import exit_code, folders_of, outcome_of, said_of
from track_before_detect.cli.spread.kept_items import (
    FINISHED,
    states_of,
    with_estimate,
    with_whole_names,
    workers_of,
)
from track_before_detect.runs.kept_results import KeptResults
from track_before_detect.runs.runner import Item, Runner

# The arguments that decide what is found and written.
_DECIDING = ('topic', 'fps', 'preset', 'explain', 'formats', 'json', 'video', 'no_overlay')


def search_on_workers(paths: Sequence[Path], arguments: Namespace, told: Mapping[str, Any],
                      words: TextIO) -> int:
    """Search each recording on a worker, but for those done before; return the exit code."""
    folders = folders_of(paths, arguments)
    options = with_whole_names(told)
    decided = {name: getattr(arguments, name) for name in _DECIDING}
    items = [{
        'input': str(path.absolute()), 'output': str(output.absolute()), 'options': options,
        'arguments': decided, 'files': states_of(path, options),
    } for path, output in zip(paths, folders, strict=True)]
    codes = []
    with Progress.asked_for(arguments, every=True) as progress:
        runner = Runner(with_estimate(progress, len(paths)), workers_of(arguments),
                        KeptResults(Path(arguments.output) / FINISHED))
        with closing(runner.each(searched, items, 'searching', _is_there, _died)) as outcomes:
            for number, outcome in outcomes:
                codes.append(said_of(paths[number], folders[number], outcome, words))
    return exit_code(codes)


def searched(item: Item) -> dict[str, Any]:
    """Search the recording of an item and write its files; see :func:`outcome_of`."""
    arguments = Namespace(**item['arguments'], quiet=True, verbose=False)
    return outcome_of(Path(item['input']), Path(item['output']), arguments, item['options'],
                      wanted_files(arguments))


def _died(item: Item) -> dict[str, Any]:
    """Return the outcome of a recording that no worker survives."""
    return {'error': f'{item["input"]}: every worker that searched it died, as where memory runs '
                     'out'}


def _is_there(item: Item, outcome: Mapping[str, Any]) -> bool:
    """Return whether a recording was searched, and its files are still there."""
    return 'error' not in outcome and all(
        (Path(item['output']) / name).exists() for name in outcome['written'])
