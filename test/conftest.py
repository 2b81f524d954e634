"""How the tests share the machine when several processes run them (pytest-xdist).

A file of tests runs in one process: its tests mostly need the same compiled loops and the same
thresholds. All tests of nodes run in one process as well, beside as many others as there are
cores: they mostly wait, and go first where they do not. What measures time is marked ``alone``.
"""

import fcntl
import functools
import os
from pathlib import Path

from hypothesis import settings
import pytest

from track_before_detect.kernels.compiled_cache import cache_folder
from track_before_detect.parallel import usable_cores

HERE = Path(__file__).parent
# Two processes that began with detectors would both compile all their loops; the tests of the
# loops, which come first, share them out. Nodes find compiled what the command and preprocessing
# need; they come next, since they take longest of all that cannot be shared out. Studies come
# last.
ORDER = {'kernels': 0, 'cli': 1, 'preprocess': 1, 'ros': 2, 'evaluation': 4}
OTHERS = 3

# Loops stay where they were compiled, wherever a test puts the user's cache.
cache_folder()

# How long an example takes depends on what the other process does.
settings.register_profile('shared', settings(), deadline=None)
settings.load_profile('shared')


@pytest.fixture
def calibrate_on(monkeypatch, tmp_path):
    """Return what makes a test calibrate anew, on at most so many crops of noise."""
    def most(n_crops):
        monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
        monkeypatch.setattr(
            'track_before_detect.solvers.calibration.threshold.MOST_CROPS', n_crops)
    return most


def place(item):
    """Return where a test comes in the order of all."""
    return ORDER.get(item.path.relative_to(HERE).parts[0], OTHERS)


def pytest_collection_modifyitems(items):
    items.sort(key=place)


@functools.cache
def let_nodes_go_first():
    """Lower the priority of this process, once: of a core both want, a quarter is left to it."""
    os.nice(5)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    return 1 + min(usable_cores(), 2)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    if config.getvalue('dist') != 'loadfile':
        return None
    from xdist.scheduler import LoadFileScheduling

    class FileScheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            file = super()._split_scope(nodeid)
            return 'nodes' if HERE / 'ros' in (config.rootpath / file).parents else file

    # In the order of collection, not the most tests first.
    config.option.loadscopereorder = False
    return FileScheduling(config, log)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    """Let a test that is marked ``alone`` wait for the others, and the others for it."""
    if not hasattr(item.config, 'workerinput'):
        yield
        return
    # By now the tests of nodes are under way in another process, or done in this one.
    if place(item) > ORDER['ros']:
        let_nodes_go_first()
    alone = item.get_closest_marker('alone') is not None
    # The first lock is held only while the second is waited for: without it tests of another
    # process could follow one another for ever before one that wants to be alone.
    with open(HERE / 'naive.py') as turn, open(__file__) as running:
        fcntl.flock(turn, fcntl.LOCK_EX)
        fcntl.flock(running, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(turn, fcntl.LOCK_UN)
        try:
            yield
        finally:
            # A process started by the test may have inherited the file.
            fcntl.flock(running, fcntl.LOCK_UN)
