"""Results of runs on disk, so that an interrupted study goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import hashlib
from importlib import resources
import json
import os
from pathlib import Path
from typing import Any

PACKAGE = 'track_before_detect'
# What a run is not decided by; the module that measures counts all the same.
_OTHER_ROOMS = ('cli.py', 'evaluation', 'ros', 'recordings')


class KeptResults:
    """Results of runs, one line of a file each.

    A line holds the code that made it, the item and the result. A line cut short by an
    interruption is passed over, so a result is there whole or not at all.

    Parameters
    ----------
    path : path
        The file; made with the first result.
    """

    def __init__(self, path: str | os.PathLike):
        self._path = Path(path)

    def load(self, measure: Callable) -> dict[str, Any]:
        """Return what a function gave, by the text of the item, while its code was the same."""
        known: dict[str, Any] = {}
        code = _code_of(measure)
        try:
            text = self._path.read_text(encoding='utf-8', errors='replace')
        except FileNotFoundError:
            return known
        for line in text.splitlines():
            try:
                made_by, item, result = json.loads(line)
            except ValueError:
                continue
            if made_by == code:
                known[item] = result
        return known

    @contextmanager
    def writer(self, measure: Callable) -> Iterator[Callable[[str, str], None]]:
        """Yield a function that keeps the text of an item and the text of its result."""
        code = _code_of(measure)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with open(self._path, 'ab') as file:
            def keep(item: str, result: str) -> None:
                line = f'[{json.dumps(code)}, {json.dumps(item)}, {result}]\n'
                file.write(line.encode())
                file.flush()

            # Ends a line that was cut short; an empty line is passed over.
            file.write(b'\n')
            yield keep


def _code_of(measure):
    """Return the name of a function and a digest of the code that decides what it returns."""
    digest = hashlib.sha256()
    for name, content in _sources(resources.files(PACKAGE), ''):
        digest.update(f'{name}\n'.encode() + content)
    module = measure.__module__
    if module.startswith(f'{PACKAGE}.'):
        folder, name = module.split('.')[1:-1], module.rsplit('.', 1)[1]
        file = resources.files(PACKAGE).joinpath(*folder, f'{name}.py')
        digest.update(file.read_bytes())
    return f'{module}.{measure.__qualname__} {digest.hexdigest()[:24]}'


def _sources(folder, prefix):
    """Yield name and content of every source file that runs may depend on."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        name = f'{prefix}{entry.name}'
        if name in _OTHER_ROOMS:
            continue
        if entry.is_dir():
            yield from _sources(entry, f'{name}/')
        elif name.endswith('.py'):
            yield name, entry.read_bytes()
