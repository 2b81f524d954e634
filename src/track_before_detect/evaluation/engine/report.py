"""What a suite hands over, and the files made of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import csv
from dataclasses import asdict, dataclass, field
import math
import os
from pathlib import Path
import tempfile
from typing import Any

from track_before_detect.errors import MissingExtraError
from track_before_detect.evaluation.engine.machine import describe_machine, machine_line
from track_before_detect.evaluation.metrics.confidence import wilson_interval
from track_before_detect.recordings.result_files import write_summary_json


@dataclass(frozen=True)
class Quantity:
    """One line of a report.

    Attributes
    ----------
    name : str
        What was estimated.
    value : float
        The estimate; NaN when there was nothing to estimate it from.
    low, high : float
        Ends of its 95 % interval.
    trials : int
        How many of what it was estimated from.
    per : str
        What was counted in ``trials``: runs, targets, batches.
    unit : str
        Unit of the value; ``%`` shows a share as per cent.
    note : str
        What to compare it with.
    """

    name: str
    value: float
    low: float
    high: float
    trials: int
    per: str
    unit: str = ''
    note: str = ''


def share(name: str, count: int, trials: int, per: str, note: str = '') -> Quantity:
    """Return a share with its Wilson interval.

    Parameters
    ----------
    name : str
        What was counted.
    count, trials : int
        How many of how many.
    per : str
        What was counted in ``trials``.
    note : str
        What to compare it with.
    """
    return Quantity(name, count / trials, *wilson_interval(count, trials), trials, per, '%', note)


@dataclass(frozen=True)
class SuiteResult:
    """What a suite found out.

    Attributes
    ----------
    title : str
        Heading of the report.
    description : str
        What was done, in a few sentences.
    rows : list of dict
        One per run, all with the same keys.
    quantities : list of Quantity
        The table of the report.
    settings : mapping
        What the runs were made with.
    draw : callable
        Draws the picture into a matplotlib figure.
    pictures : mapping
        Further pictures: what the name of the file ends in, and what draws it.
    details : str
        More of the report, in Markdown, after the pictures.
    """

    title: str
    description: str
    rows: list[dict[str, Any]]
    quantities: list[Quantity]
    settings: Mapping[str, Any]
    draw: Callable[[Any], None]
    pictures: Mapping[str, Callable[[Any], None]] = field(default_factory=dict)
    details: str = ''


def require_matplotlib() -> None:
    """Refuse before the work when its picture could not be drawn after it."""
    _figure()


def write_suite_result(output: str | os.PathLike, name: str, result: SuiteResult,
                       command: str) -> list[Path]:
    """Write table, summary, report and picture of a suite, all or none.

    Parameters
    ----------
    output : path
        Folder; made when missing, files of an earlier run are replaced.
    name : str
        Name of the suite.
    result : SuiteResult
        What it found out.
    command : str
        Command line that repeats it.

    Returns
    -------
    list of Path
        The files.
    """
    output = Path(output)
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output, prefix='.partial-') as folder:
        aside = Path(folder)
        _write_rows(aside / f'{name}.csv', result.rows)
        write_summary_json(aside / 'summary.json', {
            'suite': name,
            'command': command,
            'settings': result.settings,
            'quantities': [asdict(quantity) for quantity in result.quantities],
            'machine': describe_machine(),
        })
        (aside / 'report.md').write_text(_report(name, result, command), encoding='utf-8')
        for stem, draw in _pictures(name, result).items():
            figure = _figure()
            draw(figure)
            figure.savefig(aside / f'{stem}.png', dpi=110)
        files = sorted(aside.iterdir())
        for file in files:
            os.replace(file, output / file.name)
    return [output / file.name for file in files]


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table in Markdown; the first column to the left."""
    return ['| ' + ' | '.join(header) + ' |', '|---|' + '---:|' * (len(header) - 1),
            *('| ' + ' | '.join(row) + ' |' for row in rows)]


def table_text(quantities: Sequence[Quantity]) -> str:
    """Return the quantities as lines of text with aligned columns."""
    rows = [('quantity', 'value', '95 % interval', 'from', ''), *map(_cells, quantities)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join('  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
                     .rstrip() for row in rows)


def _figure():
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError(
            "the picture of a suite needs matplotlib: pip install 'track_before_detect[plots]'"
        ) from error
    figure = Figure(figsize=(11, 4.5), layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def _write_rows(path, rows):
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator='\n')
        writer.writeheader()
        writer.writerows({key: _field(value) for key, value in row.items()} for row in rows)


def _field(value):
    """Return what stands for a value in a table; nothing for one that is not known."""
    if not isinstance(value, float):
        return value
    return f'{value:.6g}' if math.isfinite(value) else ''


def _pictures(name, result):
    """Return what draws each picture, by the name of its file without the suffix."""
    return {name: result.draw,
            **{f'{name}_{suffix}': draw for suffix, draw in result.pictures.items()}}


def _report(name, result, command):
    lines = [
        f'# {result.title}', '', result.description, '',
        '| quantity | value | 95 % interval | from | |',
        '|---|---:|---:|---:|---|',
        *('| ' + ' | '.join(_cells(quantity)) + ' |' for quantity in result.quantities), '',
        *(line for stem in _pictures(name, result)
          for line in (f'![{result.title}]({stem}.png)', '')),
        *([result.details, ''] if result.details else []),
        f'Made with `{command}` on {machine_line()}.', '',
    ]
    return '\n'.join(lines)


def _cells(quantity):
    """Return the columns of one quantity as text."""
    return (quantity.name, _shown(quantity.value, quantity.unit),
            f'{_shown(quantity.low, quantity.unit)} to {_shown(quantity.high, quantity.unit)}',
            f'{quantity.trials} {quantity.per}', quantity.note)


def _shown(value, unit):
    if unit == '%':
        return f'{100 * value:.1f} %'
    return f'{value:.3g}{" " if unit else ""}{unit}'
