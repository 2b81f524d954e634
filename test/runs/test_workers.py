"""Workers of a cluster that die."""

import os
from pathlib import Path
import signal

import pytest

from track_before_detect.runs.workers import Workers


def dying_once(argument):
    """Return a number, but end the worker that is asked first, where there is a mark to leave."""
    number, mark = argument
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_what_a_worker_that_dies_was_at_is_done_by_another(tmp_path):
    pytest.importorskip('distributed')
    mark = str(tmp_path / 'was_here')
    results = Workers(1, 'dask').run(dying_once, [(1, ''), (2, mark), (3, '')])
    assert sorted(results) == [1, 2, 3]
    assert Path(mark).exists()
