"""Results of runs on disk, so that an interrupted study goes on where it stopped."""

import ast
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import hashlib
from importlib import resources
import json
import os
from pathlib import Path
from typing import Any

PACKAGE = 'track_before_detect'


class KeptResults:
    """Results of runs, one line of a file each.

    A line holds the code that made it, the item and the result. A change of a module that the
    measuring one does not import, in the end, leaves results as they are. A line cut short by an
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


def _code_of(measure: Callable) -> str:
    """Return the name of a function and a digest of the code that decides what it returns."""
    digest = hashlib.sha256()
    for name, source in sorted(sources_of(measure.__module__).items()):
        digest.update(f'{name}\n'.encode() + source)
    return f'{measure.__module__}.{measure.__qualname__} {digest.hexdigest()[:24]}'


def sources_of(module: str) -> dict[str, bytes]:
    """Return the sources of a module and of all of this package that it comes to import."""
    sources: dict[str, bytes] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        source = _source(name)
        if name not in sources and source is not None:
            sources[name] = source
            waiting += _imported(source)
    return sources


def _source(name: str) -> bytes | None:
    """Return the source of a module of this package; None for anything else."""
    package, *parts = name.split('.')
    if package != PACKAGE or not parts:
        return None
    file = resources.files(PACKAGE).joinpath(f'{"/".join(parts)}.py')
    return file.read_bytes() if file.is_file() else None


def _imported(source: bytes) -> Iterator[str]:
    """Yield the names that a source imports, and those of what may be a module in a folder."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ''
            yield from (f'{node.module}.{alias.name}' for alias in node.names)
