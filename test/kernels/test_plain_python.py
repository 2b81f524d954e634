"""The kernels are plain Python as well, which a debugger and coverage can see."""

import os
from pathlib import Path
import subprocess
import sys

HERE = Path(__file__).parent
QUICK = ('fit', 'psf', 'test_transition_dp.py')


def test_kernels_equal_their_twins_without_the_compiler():
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider',
         *(str(HERE / name) for name in QUICK)],
        cwd=HERE.parents[1], env={**os.environ, 'NUMBA_DISABLE_JIT': '1'}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=300)
    assert done.returncode == 0, done.stdout
    assert ' passed' in done.stdout
    assert ' skipped' not in done.stdout
