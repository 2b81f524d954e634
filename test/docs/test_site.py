"""What the documentation site shows is made by what it says."""

import importlib.util
from pathlib import Path
import re

import pytest

DOCS = Path(__file__).parents[2] / 'docs'


def loaded(path):
    """Return a script of the documentation as a module."""
    if not path.exists():
        pytest.skip('the tests do not run from the source folder')
    found = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_the_page_names_the_command_of_each_of_its_pictures():
    pictures = loaded(DOCS / 'guide' / 'pictures.py')
    page = (DOCS / 'guide' / 'your_own_data.md').read_text(encoding='utf-8')
    shown = re.findall(r'!\[[^]]*\]\((\w+)\.png\)\s+\*`tbd ([^`]+)`', page)
    assert {name: ' '.join(command.split()) for name, command in shown} == pictures.COMMANDS
    assert all((DOCS / 'guide' / f'{name}.png').exists() for name in pictures.COMMANDS)


def test_recordings_of_the_pictures_are_those_the_page_describes():
    pictures = loaded(DOCS / 'guide' / 'pictures.py')
    frames, truth = pictures.recording((7.0, 1.0), 6.0, pan=0.5)
    assert frames.shape == (48, 128, 160) and frames.dtype == 'uint8'
    steps = truth[1:, 2:] - truth[:-1, 2:]
    assert abs(steps - (7, 1)).max() < 1e-9


def test_links_that_lead_nowhere_are_found(tmp_path):
    check = loaded(DOCS / 'check_links.py')
    (tmp_path / 'one.html').write_text(
        '<a href="two.html#there"><a href="two.html#gone"><a href="three.html"><img src="a.png">'
        '<a href="https://example.org/x"><a href="#"><a href="#here"><p id="here">')
    (tmp_path / 'two.html').write_text('<h1 id="there">')
    assert list(check.broken_links(tmp_path)) == [
        'one.html: two.html#gone', 'one.html: three.html', 'one.html: a.png']
