"""Workers of a cluster that die."""

import subprocess
import sys

import pytest

PROGRAM = """
import os
from pathlib import Path
import signal
import sys

from track_before_detect.runs.workers import Workers


def dying_once(argument):
    number, mark = argument
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


if __name__ == '__main__':
    print(sorted(Workers(1, 'dask').run(dying_once, [(1, ''), (2, sys.argv[1]), (3, '')])))
"""


def test_what_a_worker_that_dies_was_at_is_done_again(tmp_path):
    pytest.importorskip('distributed')
    program, mark = tmp_path / 'program.py', tmp_path / 'was_here'
    program.write_text(PROGRAM)
    # Not here, where a warning of the cluster in another thread would be an error.
    done = subprocess.run([sys.executable, program, mark], capture_output=True, text=True,
                          timeout=300)
    assert done.stdout == '[1, 2, 3]\n', done.stderr
    assert mark.exists()
