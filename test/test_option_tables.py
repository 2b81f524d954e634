"""The tables of README.md say what the options and the capabilities declare."""

from pathlib import Path

from track_before_detect.option_tables import TABLES, with_tables
from track_before_detect.options import describe, DETECTORS

README = Path(__file__).parents[1] / 'README.md'


def test_tables_of_the_readme_are_those_of_the_code():
    # python -m track_before_detect.option_tables README.md writes them anew.
    text = README.read_text(encoding='utf-8')
    assert [f'<!-- table: {name} -->' in text for name in TABLES] == [True] * len(TABLES)
    assert with_tables(text) == text


def test_every_option_and_detector_is_in_the_tables():
    lines = TABLES['parameters']().splitlines()
    assert [line.split('`')[1] for line in lines[2:]] == [one['name'] for one in describe()]
    # A bar would begin another column.
    assert {line.replace(r'\|', '').count('|') for line in lines} == {4}
    assert all(f'`{name}`' in TABLES['detectors']() for name in DETECTORS)
