"""The files that are made of what a suite found out."""

from collections.abc import Callable, Sequence
import csv
from dataclasses import asdict
import math
import os
from pathlib import Path
from typing import Any

from track_before_detect.atomic_files import atomic_folder
from track_before_detect.evaluation.engine.machine import describe_machine, machine_line
from track_before_detect.evaluation.engine.pictures import new_figure
from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.engine.suite import SuiteResult
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.recordings.result_files import write_summary_json


def require_matplotlib() -> None:
    """Refuse before the work when its picture could not be drawn after it."""
    new_figure()


def write_suite_result(output: str | os.PathLike, name: str, result: SuiteResult,
                       command: str) -> list[Path]:
    """Write table, summary, report and picture of a suite, all or none; return the files.

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
    """
    output = Path(output)
    with atomic_folder(output) as aside:
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
            figure = new_figure()
            draw(figure)
            figure.savefig(aside / f'{stem}.png', dpi=110)
        names = sorted(file.name for file in aside.iterdir())
    return [output / name for name in names]


def table_text(quantities: Sequence[Quantity]) -> str:
    """Return the quantities as lines of text with aligned columns."""
    header = ('quantity', 'value', '95 % interval', 'from', '')
    return '\n'.join(aligned([header, *map(_cells, quantities)], left=True))


def _write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator='\n')
        writer.writeheader()
        writer.writerows({key: _field(value) for key, value in row.items()} for row in rows)


def _field(value: Any) -> Any:
    """Return what stands for a value in a table; nothing for one that is not known."""
    if not isinstance(value, float):
        return value
    return f'{value:.6g}' if math.isfinite(value) else ''


def _pictures(name: str, result: SuiteResult) -> dict[str, Callable[[Any], None]]:
    """Return what draws each picture, by the name of its file without the suffix."""
    return {name: result.draw,
            **{f'{name}_{suffix}': draw for suffix, draw in result.pictures.items()}}


def _report(name: str, result: SuiteResult, command: str) -> str:
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


def _cells(quantity: Quantity) -> tuple[str, ...]:
    """Return the columns of one quantity as text."""
    return (quantity.name, _shown(quantity.value, quantity.unit),
            f'{_shown(quantity.low, quantity.unit)} to {_shown(quantity.high, quantity.unit)}',
            f'{quantity.trials} {quantity.per}', quantity.note)


def _shown(value: float, unit: str) -> str:
    if unit == '%':
        return f'{100 * value:.1f} %'
    return f'{value:.3g}{" " if unit else ""}{unit}'
