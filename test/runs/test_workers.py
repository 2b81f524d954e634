"""Workers of a cluster: those that die, and none where there is nothing to do."""

import subprocess
import sys

import pytest

from track_before_detect.runs.workers import Workers

PROGRAM = """
import os
from pathlib import Path
import signal
import sys

from track_before_detect.runs.workers import Workers


def dying(argument):
    number, mark = argument
    if mark == 'always' or mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


if __name__ == '__main__':
    print(sorted(Workers(1, 'dask').run(
        dying, [(1, ''), (2, sys.argv[1]), (3, 'always'), (4, '')], lambda one: -one[0])))
"""


def test_what_workers_died_with_is_done_again_and_given_up_where_they_die_again(tmp_path):
    pytest.importorskip('distributed')
    program, mark = tmp_path / 'program.py', tmp_path / 'was_here'
    program.write_text(PROGRAM)
    # Not here, where a warning of the cluster in another thread would be an error.
    done = subprocess.run([sys.executable, program, mark], capture_output=True, text=True,
                          timeout=300, cwd=tmp_path)
    assert done.stdout == '[-3, 1, 2, 4]\n', done.stderr
    assert mark.exists()


def test_nobody_is_asked_where_nothing_is_left_to_do():
    # To connect would fail.
    assert list(Workers(backend='dask', scheduler='tcp://127.0.0.1:1').run(abs, [])) == []
