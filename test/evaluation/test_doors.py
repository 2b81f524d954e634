"""Who imports the studies and benches, and what these import of the rest."""

import ast
from pathlib import Path
import re

import track_before_detect
from track_before_detect import evaluation

PACKAGE = 'track_before_detect'
SOURCE = Path(track_before_detect.__file__).parent
ROOM = Path(evaluation.__file__).parent


def imported_modules(path):
    """Return the modules of the package that a file imports from, wherever in the file."""
    return {node.module.removeprefix(f'{PACKAGE}.')
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
            if isinstance(node, ast.ImportFrom) and node.module.startswith(f'{PACKAGE}.')}


def test_only_commands_that_measure_import_studies_and_benches():
    importers = {path.relative_to(SOURCE).parts for path in SOURCE.rglob('*.py')
                 if ROOM not in path.parents
                 and any(name.startswith('evaluation') for name in imported_modules(path))}
    assert importers
    assert importers == {('cli', 'evaluate.py'), ('cli', 'bench.py')}


def test_doors_of_the_rest_are_those_that_the_package_names():
    used = {name for path in ROOM.rglob('*.py') for name in imported_modules(path)
            if not name.startswith('evaluation')}
    doors = evaluation.__doc__.partition('the doors')[2]
    assert used == set(re.findall(r'``([\w.]+)``', doors))
