"""Compiled loops on disk: found by later processes, and never those of another source."""

from contextlib import ExitStack
import fcntl
import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

from track_before_detect.kernels import compiled_cache

FLAGS = 'from track_before_detect.kernels.compile_flags import EXACT'
FILES = {
    'deeper.py': 'FACTOR = 2.0\n',
    'inner.py': f"""import numba
{FLAGS}
from track_before_detect.kernels.deeper import (
    FACTOR,
)
@numba.njit(**EXACT)
def inner(x):
    return FACTOR * x
""",
    'outer.py': f"""import numba
{FLAGS}
from track_before_detect.kernels.inner import inner
@numba.njit(**EXACT)
def outer(x):
    return inner(x) + 1.0
""",
    'apart.py': f"""import numba
{FLAGS}
@numba.njit(**EXACT)
def apart(x):
    return -x
"""}
# Value and number of compilations of each loop called.
PROGRAM = """from track_before_detect.kernels.outer import outer
from track_before_detect.kernels.apart import apart
for loop in (outer, apart):
    value = loop(3.0)
    print(value, sum(loop.stats.cache_misses.values()))
"""


@pytest.fixture
def kernels(tmp_path):
    """Return a folder of kernels in a package of our name that holds little else."""
    folder = tmp_path / 'installed' / 'track_before_detect' / 'kernels'
    folder.mkdir(parents=True)
    for package in (folder, folder.parent):
        (package / '__init__.py').touch()
    for name in ('compile_flags.py', 'compiled_cache.py'):
        shutil.copy(Path(compiled_cache.__file__).with_name(name), folder)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


def start(kernels, **environment):
    base = {key: value for key, value in os.environ.items() if key != 'NUMBA_CACHE_DIR'}
    tops = [str(kernels.parents[1]), *filter(None, [os.environ.get('PYTHONPATH')])]
    return subprocess.Popen(
        [sys.executable, '-B', '-c', PROGRAM], stdout=subprocess.PIPE, text=True,
        env={**base, 'PYTHONPATH': os.pathsep.join(tops),
             'XDG_CACHE_HOME': str(kernels.parents[2] / 'cache'),
             **{key: str(value) for key, value in environment.items()}})


def finish(child):
    """Return the value of ``outer`` and how often it, and ``apart``, had to be compiled."""
    words = child.communicate(timeout=60)[0].split()
    assert child.returncode == 0
    return float(words[0]), int(words[1]), int(words[3])


def run(kernels, **environment):
    return finish(start(kernels, **environment))


def edit(kernels, name, old, new):
    path = kernels / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_loop_is_compiled_anew_when_what_it_calls_from_other_files_has_changed(kernels):
    assert run(kernels) == (7.0, 1, 1)
    # Two files away from the loop, and what has nothing to do with it is kept.
    edit(kernels, 'deeper.py', '2.0', '5.0')
    assert run(kernels) == (16.0, 1, 0)
    # The settings of the compiler are imported by all.
    edit(kernels, 'compile_flags.py', "'nogil': True", "'nogil': False")
    assert run(kernels) == (16.0, 1, 1)


def test_another_installation_of_the_same_sources_finds_what_is_compiled(kernels, tmp_path):
    before = sorted(kernels.parent.rglob('*'))
    assert run(kernels) == (7.0, 1, 1)
    # It may be read-only: nothing is written there.
    assert sorted(kernels.parent.rglob('*')) == before
    other = tmp_path / 'elsewhere' / 'lib' / 'track_before_detect'
    shutil.copytree(kernels.parent, other)
    assert run(other / 'kernels', XDG_CACHE_HOME=tmp_path / 'cache') == (7.0, 0, 0)


def test_the_folder_in_numba_cache_dir_is_used(kernels, tmp_path):
    assert run(kernels, NUMBA_CACHE_DIR=tmp_path / 'chosen') == (7.0, 1, 1)
    assert list((tmp_path / 'chosen').rglob('outer.outer*.nbc'))
    assert not (tmp_path / 'cache').exists()


def test_without_a_cache_of_the_user_another_place_serves(kernels, tmp_path):
    (tmp_path / 'file').touch()
    assert run(kernels, XDG_CACHE_HOME=tmp_path / 'file') == (7.0, 1, 1)
    assert list((kernels.parent / '__pycache__').rglob('outer.outer*.nbc'))
    # Nor is there a place beside the sources now: nothing is kept, and all works.
    shutil.rmtree(kernels.parent / '__pycache__')
    (kernels.parent / '__pycache__').touch()
    (tmp_path / 'temporary').mkdir()
    assert run(kernels, XDG_CACHE_HOME=tmp_path / 'file',
               TMPDIR=tmp_path / 'temporary') == (7.0, 1, 1)
    assert not list((tmp_path / 'temporary').iterdir())


def test_of_two_processes_at_once_one_compiles(kernels):
    children = [start(kernels) for _ in range(2)]
    values, *compiled = zip(*map(finish, children), strict=True)
    assert values == (7.0, 7.0)
    assert [sum(counts) for counts in compiled] == [1, 1]


def test_nobody_waits_for_a_process_that_compiles_other_loops(kernels, tmp_path):
    assert run(kernels) == (7.0, 1, 1)
    with ExitStack() as held:
        for path in (tmp_path / 'cache').rglob('lock'):
            fcntl.flock(held.enter_context(path.open('ab')), fcntl.LOCK_EX)
        # One is loaded, the other compiled into another folder.
        edit(kernels, 'apart.py', 'return -x', 'return -2.0 * x')
        assert run(kernels) == (7.0, 0, 1)


def test_folders_that_nobody_has_used_for_long_are_deleted(kernels, tmp_path):
    run(kernels)
    folders = list((tmp_path / 'cache' / 'track_before_detect' / 'loops').iterdir())
    old, *others = [folder for folder in folders if folder.is_dir()]
    os.utime(old, (0, 0))
    edit(kernels, f'{old.name.split("-")[0]}.py', 'import numba', 'import  numba')
    run(kernels)
    assert not old.exists()
    assert all(folder.exists() for folder in others)
