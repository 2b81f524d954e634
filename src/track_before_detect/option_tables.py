"""The tables of options and detectors in README.md, made of what the code declares.

``python -m track_before_detect.option_tables README.md`` writes them anew after an option or a
capability was added or changed.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
import re
import sys
import textwrap
from typing import Any

from track_before_detect.capabilities import (
    CAPABILITIES,
    Capability,
    COMBINATIONS,
    Limit,
    NoEffect,
    SEVERAL_SENSORS,
    value_words,
    WITHOUT_EFFECT,
)
from track_before_detect.options import describe, range_words

_MARKED = re.compile(r'(?<=<!-- table: )(\w+)( -->\n).*?(?=<!-- end of table -->)', re.DOTALL)
_ASSIGNMENT = re.compile(r'(\w+=[\w-]+)')


def with_tables(text: str) -> str:
    """Return a text with each table anew that stands between its markers."""
    return _MARKED.sub(lambda found: f'{found[1]}{found[2]}\n{TABLES[found[1]]()}\n\n', text)


def parameters() -> str:
    """Return every option with its default, meaning, unit and range."""
    return _table(('parameter', 'default', 'meaning'), (
        (f'`{option["name"]}`', value_words(option['name'], option['default']), _meaning(option))
        for option in describe()))


def detectors() -> str:
    """Return what each detector does."""
    return _table(('detector', 'method'), (
        (_codes(one.detectors), one.method) for one in CAPABILITIES))


def capabilities() -> str:
    """Return which detectors honour which values of the options that some do not."""
    limited = {limit.option for one in CAPABILITIES for limit in one.limits}
    header = ['', *(_codes(dict.fromkeys((one.detectors[0], one.detectors[-1])), ' … ')
                    for one in CAPABILITIES)]
    return _table(header, (
        (f'`{option["name"]}`', *(_cell(option, one) for one in CAPABILITIES))
        for option in describe() if option['name'] in limited))


def combinations() -> str:
    """Return what cannot be combined, and what has no effect beside something else."""
    lines = [f'- {names} {when}: only {values} ({reason}).'
             for names, when, values, reason in _merged((*COMBINATIONS, *SEVERAL_SENSORS))]
    lines += [f'- {names} {when}: no effect ({reason}).'
              for names, when, _, reason in _merged(WITHOUT_EFFECT)]
    return '\n'.join(lines)


def yaml_entry(option: Mapping[str, Any], indent: str, mark: str = '',
               more_facts: Iterable[str] = ()) -> list[str]:
    """Return the lines of an option in a YAML file, with its default and its meaning as comment.

    Parameters
    ----------
    option : mapping
        An entry of ``describe``, or a parameter of a node with the same names.
    indent, mark : str
        What each line begins with, and what its value is commented out by.
    more_facts : iterable of str
        Told after unit and range.
    """
    facts = [*([option['unit']] if option['unit'] else []), *range_words(option), *more_facts]
    text = f'{option["description"]} [{"; ".join(facts)}]' if facts else option['description']
    return [*textwrap.wrap(text, 91 + len(indent), initial_indent=f'{indent}# ',
                           subsequent_indent=f'{indent}# '),
            f'{indent}{mark}{option["name"]}: {_yaml(option["default"])}']


def _yaml(value: Any) -> str:
    if isinstance(value, str):
        return f"'{value}'"
    if isinstance(value, (list, tuple)):
        return f'[{", ".join(map(_yaml, value))}]'
    return {True: 'true', False: 'false', None: 'null'}[value] if (
        value is None or isinstance(value, bool)) else repr(value)


TABLES = {table.__name__: table for table in (parameters, detectors, capabilities, combinations)}


def _meaning(option: dict[str, Any]) -> str:
    unit = [option['unit']] if option['unit'] else []
    choices = [f'one of {_codes(option["choices"])}'] if option['choices'] else []
    facts = [*unit, *choices, *range_words({**option, 'choices': None})]
    text = f'{option["description"]} [{"; ".join(facts)}]' if facts else option['description']
    return text.replace('|', r'\|')


def _cell(option: dict[str, Any], one: Capability) -> str:
    """Return what detectors honour of an option that some do not."""
    limit = next((limit for limit in one.limits if limit.option == option['name']), None)
    if limit is None:
        return 'any'
    if not limit.allowed:
        return f'`{option["default"]}`' if option['choices'] else '–'
    if not limit.no_effect:
        return _codes((option['default'], *limit.allowed))
    chosen = [value for value in limit.allowed if value not in limit.no_effect]
    return f'{_codes(chosen)}, else ' * bool(chosen) + f'always {_codes(limit.no_effect)}'


def _merged(limits: Sequence[Limit | NoEffect]) -> Iterator[tuple[str, ...]]:
    """Yield the options that share all else: their names, when, allowed values and reason."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for limit in limits:
        values = limit.values if isinstance(limit, Limit) else ''
        when = limit.when.words if limit.when else 'of several sensors'
        key = (_ASSIGNMENT.sub(r'`\1`', when), values, limit.reason)
        groups.setdefault(key, []).append(limit.option)
    for (when, values, reason), names in groups.items():
        yield _codes(names), when, values, reason


def _codes(names: Iterable[str], separator: str = ', ') -> str:
    return separator.join(f'`{name}`' for name in names)


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return '\n'.join('| ' + ' | '.join(row) + ' |'
                     for row in (header, ['---'] * len(header), *rows))


def main(readme: str) -> None:
    """Write the tables of a README anew."""
    path = Path(readme)
    path.write_text(with_tables(path.read_text(encoding='utf-8')), encoding='utf-8')


if __name__ == '__main__':
    main(sys.argv[1])
