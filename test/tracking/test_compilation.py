"""What is told of loops while they are compiled, and whether all that are needed are known."""

import json
import re
import subprocess
import sys

import numba
import numpy as np
import pytest

from track_before_detect.errors import TbdError
from track_before_detect.kernels.fit.least_squares import find_blocks
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.compilation import told_of_compiling
from track_before_detect.tracking.presets import PRESETS
from track_before_detect.types import Count

# Prints the loops that Python calls in a search and that nobody has listed, and the other way.
PROGRAM = """import json, sys
from numba.core.dispatcher import Dispatcher
from track_before_detect.kernels.fit.least_squares import find_blocks
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.compilation import entries_of
from track_before_detect.tracking.pipeline import TrackingPipeline
options = DetectorOptions(**json.loads(sys.argv[1]))
TrackingPipeline(options).compile()
prefix = 'track_before_detect.kernels.'
called = {f'{name.removeprefix(prefix)}:{loop.__name__}'
          for name, module in list(sys.modules.items()) if name.startswith(prefix)
          for loop in vars(module).values() if isinstance(loop, Dispatcher)
          and loop.__module__ == name and loop.overloads}
# What was compiled just now has had loops compiled that Python does not call.
if any(loop.stats.cache_misses for module in list(sys.modules.values())
       for loop in vars(module).values() if isinstance(loop, Dispatcher)):
    sys.exit(7)
print(json.dumps([sorted(called - set(entries_of(options))),
                  sorted(set(entries_of(options)) - called)]))
"""


@pytest.mark.parametrize('options', [
    {}, {'detector': 'cfo_dpr'}, {'detector': 'velocity_filter'}, PRESETS['eoir_moving']],
    ids=['default', 'cfo_dpr', 'velocity_filter', 'eoir_moving'])
def test_all_loops_of_a_search_are_known(options):
    for _ in range(2):
        child = subprocess.run([sys.executable, '-c', PROGRAM, json.dumps(options)], text=True,
                               stdout=subprocess.PIPE)
        if child.returncode != 7:
            break
    assert child.returncode == 0
    missing, unused = json.loads(child.stdout)
    assert not missing
    assert not unused


def compile_nested():
    """Compile a loop of ours within another one, which no cache knows."""
    inner = numba.njit(find_blocks.py_func)

    @numba.njit
    def outer(matrix, order, ends):
        return inner(matrix, order, ends)

    return outer(np.eye(3), np.zeros(3, np.int64), np.zeros(3, np.int64))


def test_the_number_of_loops_is_told_from_the_first_to_the_last():
    told = []
    with told_of_compiling(lambda *now: told.append(now), DetectorOptions()):
        assert compile_nested() == 3
    labels, shares = zip(*told, strict=True)
    assert set(labels) == {'compiling'} and len(told) > 1
    assert all(re.fullmatch(r'\d+ of \d+ loops, \d+ s', str(share)) for share in shares)
    assert all(isinstance(share, Count) and 0 <= share <= 1 for share in shares)
    done = [int(str(share).split()[0]) for share in shares]
    assert done == sorted(done) and done[-1] == done[0] + 1


def test_an_error_of_progress_ends_the_compilation_as_what_it_is():
    told = []

    def progress(label, done):
        told.append(label)
        if len(told) == 2:
            # Within the types of another loop, where numba would take it for one of its own.
            raise TbdError('enough')

    with pytest.raises(TbdError, match='enough'), told_of_compiling(progress, DetectorOptions()):
        compile_nested()
    assert compile_nested() == 3
