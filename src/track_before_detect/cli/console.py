"""What the command and the demo read and print: arguments, errors, tables, progress."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
import importlib.util
import os
from pathlib import Path
import sys
import textwrap
from typing import Any, NoReturn, TextIO

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import MissingExtraError, ParameterError
from track_before_detect.options import range_words
from track_before_detect.types import Count, Trajectory

FOUND, FAILED, BAD_INPUT, NOTHING_FOUND, INTERRUPTED, TERMINATED = 0, 1, 2, 3, 130, 143


def fail(program: str, message: object, code: int = BAD_INPUT) -> int:
    """Say what is wrong in one line and return the exit code."""
    print(f'{program}: error: {" ".join(str(message).split())}', file=sys.stderr)
    return code


def error_words(error: Exception) -> str:
    """Return what an error says; what the system says of memory helps nobody."""
    if isinstance(error, MemoryError):
        return 'not enough memory for this recording; a smaller batch_length needs less'
    return str(error)


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence, like every other error of a command."""

    def __init__(self, **kwargs: Any):
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **kwargs)

    def error(self, message: str) -> NoReturn:
        """End with what is wrong."""
        self.exit(fail(self.prog.partition(' ')[0], f'{message} (see {self.prog} --help)'))


class PrintAndExit(argparse.Action):
    """Print what ``text`` returns and exit."""

    def __init__(self, option_strings: Sequence[str], dest: str, *, text: Callable[[], str],
                 **kwargs: Any):
        super().__init__(option_strings, dest, nargs=0, **kwargs)
        self._text = text

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Act on the argument."""
        print(self._text())
        parser.exit()


def add_set_argument(parser: argparse.ArgumentParser, help_text: str) -> None:
    """Add ``--set KEY=VALUE``, which may be repeated."""
    parser.add_argument('--set', metavar='KEY=VALUE', action='append', default=[], help=help_text)


def add_output_argument(parser: argparse.ArgumentParser, files: str = 'the results',
                        folder: str = 'output') -> None:
    """Add ``--output DIR`` for these files, in that folder unless told."""
    parser.add_argument('--output', metavar='DIR', default=folder,
                        help=f'folder for {files}, made when missing; files of an earlier run are '
                        f'replaced (default: {folder})')


def add_loudness(parser: argparse.ArgumentParser) -> None:
    """Add how much is said beside the result."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument('--quiet', '-q', action='store_true',
                        help='say nothing beside the result but warnings and errors')
    either.add_argument('--verbose', '-v', action='store_true',
                        help='say how far each step is, and of errors where they come from')


def assignments(texts: Iterable[str], option: str = '--set') -> dict[str, str]:
    """Return the keys and values of ``--set KEY=VALUE``, or of an option of another name."""
    values = {}
    for text in texts:
        key, separator, value = text.partition('=')
        if not separator or not key.strip():
            raise ParameterError(f'{option} needs KEY=VALUE, got {text!r}')
        values[key.strip()] = value.strip()
    return values


def check_output_folder(output: Path) -> None:
    """Refuse before the work a folder that could not be made or written to after it."""
    existing = output
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ParameterError(f'--output must be a folder, but {existing} is a file')
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ParameterError(f'--output {output} cannot be written: no permission in {existing}')


def check_apart(inputs: Iterable[Path], outputs: Iterable[Path]) -> None:
    """Refuse results within a folder that is an input, among whose files they would be read."""
    folders = {path.resolve(): path for path in inputs if path.is_dir()}
    for output in outputs:
        if (path := folders.get(output.resolve())) is not None:
            raise ParameterError(f'results would go into {path}, among the files of the input: '
                                 '--output must be another folder')


def check_output_file(output: Path, *suffixes: str, name: str = '--output') -> None:
    """Refuse before the work a file of another type, or one in a folder that does not exist."""
    if output.suffix not in suffixes:
        raise ParameterError(f'{name} must end with {" or ".join(suffixes)}, got {output}')
    if not output.parent.is_dir():
        raise ParameterError(f'folder {output.parent} of {name} does not exist')


def require_extra(package: str, extra: str, what: str, otherwise: str = '') -> None:
    """Refuse before the work what could not be done after it for want of a package."""
    if importlib.util.find_spec(package) is None:
        raise MissingExtraError(f"{what} needs {package}: pip install "
                                f"'track_before_detect[{extra}]'{otherwise}")


def table(rows: Iterable[Sequence[str]]) -> str:
    """Return rows of cells as text with aligned columns."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join('  '.join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
                     for row in rows)


def trajectory_header(stamps_known: bool) -> list[str]:
    """Return the names of the columns of :func:`trajectory_cells`.

    Where stamps are made up a frame is a second, and speeds are told by what is known.
    """
    return ['id', 'frames', 'first x, y [px]', 'last x, y [px]',
            f'speed [px/{"s" if stamps_known else "frame"}]', 'snr']


def trajectory_cells(trajectory: Trajectory) -> list[str]:
    """Return where a trajectory was and how fast, over the frames in which it is present."""
    present = np.isfinite(trajectory.positions).all(axis=1)
    positions = trajectory.positions[present]
    speeds = np.hypot(*trajectory.velocity[present].T)
    speeds = speeds[np.isfinite(speeds)]
    return [str(trajectory.id), first_and_last(trajectory.frame_indices[present]),
            position_cell(positions[0]), position_cell(positions[-1]),
            f'{speeds.mean():.2f}' if len(speeds) else '-', f'{trajectory.snr:.2f}']


def first_and_last(frames: NDArray[np.int64]) -> str:
    """Return the span of frame numbers as text."""
    return f'{frames[0]}-{frames[-1]}'


def position_cell(position: NDArray[np.float64]) -> str:
    """Return x and y as text."""
    return f'{position[0]:.1f}, {position[1]:.1f}'


def option_lines(option: Mapping[str, Any], automatic: str) -> str:
    """Return the description of an option; ``automatic`` stands for the default None."""
    default = option['default']
    shown = automatic if default is None else (
        ','.join(f'{value:g}' for value in default) if isinstance(default, tuple) else default)
    facts = [f'default {shown}', *range_words(option)]
    unit = f' [{option["unit"]}]' if option['unit'] else ''
    return f'  {option["name"]}{unit}: {"; ".join(facts)}\n{indented(option["description"])}'


def indented(text: str) -> str:
    """Return a paragraph below the name it explains."""
    return textwrap.fill(text, 96, initial_indent=' ' * 6, subsequent_indent=' ' * 6)


class Progress:
    """Shows progress: a bar on a terminal, otherwise one line per task.

    Parameters
    ----------
    stream : text stream
    every : bool
        Whether a line tells of every loop that is compiled.
    in_tenths : bool
        Whether a line tells of every tenth of a task.
    silent : bool
        Whether nothing is shown.
    """

    def __init__(self, stream: TextIO, every: bool = False, in_tenths: bool = False,
                 silent: bool = False):
        self._stream = stream
        self._in_tenths = in_tenths
        self._silent = silent
        self._label = ''
        self._announced: set[str] = set()
        self._every = every
        self._bar: Any = None
        self._new_bar: Callable[..., Any] | None = None
        if stream.isatty() and importlib.util.find_spec('tqdm') is not None:
            from tqdm import tqdm
            self._new_bar = tqdm

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def __call__(self, label: str, done: float) -> None:
        """Show that the share ``done`` (0..1) of the task ``label`` is done."""
        words = f'{label}: {done}' if isinstance(done, Count) else label
        if self._silent:
            return
        if self._in_tenths and words == label:
            words = f'{label}: {int(10 * done)}0 %'
        if self._new_bar is None:
            # Every batch may go through the same tasks again.
            told = words if self._every or self._in_tenths else label
            if told not in self._announced:
                print(f'tbd: {words}', file=self._stream, flush=True)
                self._announced.add(told)
            return
        if label != self._label:
            self._close()
            self._label = label
            self._bar = self._new_bar(
                total=1.0, desc=label, file=self._stream, leave=False,
                bar_format='{desc}: {percentage:3.0f} %|{bar}| {elapsed}')
        self._bar.set_description_str(words, refresh=False)
        self._bar.update(min(max(done, 0.0), 1.0) - self._bar.n)

    @classmethod
    def asked_for(cls, arguments: argparse.Namespace, every: bool = False) -> Progress:
        """Return one that says as much on the stream of errors as the arguments ask for."""
        return cls(sys.stderr, every, in_tenths=arguments.verbose, silent=arguments.quiet)

    def show_time(self) -> None:
        """Show that time goes on, where nothing else can be told of a task."""
        bar = self._bar
        if bar is not None:
            bar.refresh()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
