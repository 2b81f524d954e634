"""How the tests share the machine when several processes run them (pytest-xdist).

A file of tests runs in one process: its tests mostly need the same compiled loops and the same
thresholds. All tests of nodes run in one process as well; they mostly wait, so others run beside
them. What measures time is marked ``alone``.
"""

import fcntl
from pathlib import Path

from hypothesis import settings
import pytest

from track_before_detect.kernels.compiled_cache import cache_folder

HERE = Path(__file__).parent

# How long an example takes depends on what the other process does.
settings.register_profile('shared', settings(), deadline=None)
settings.load_profile('shared')


@pytest.fixture
def calibrate_on(monkeypatch, tmp_path):
    """Return what makes a test calibrate anew, on at most so many crops of noise."""
    def most(n_crops):
        # Loops stay where they were compiled.
        cache_folder()
        monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
        monkeypatch.setattr(
            'track_before_detect.solvers.calibration.threshold.MOST_CROPS', n_crops)
    return most


def pytest_collection_modifyitems(items):
    # Two processes that began with detectors would both compile all their loops; the tests of the
    # loops, which come first, share them out. Studies come last: they find them compiled.
    order = {'kernels': 0, 'evaluation': 2}
    items.sort(key=lambda item: order.get(item.path.relative_to(HERE).parts[0], 1))


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
