"""``tbd plan``: what it expects is what a search then costs."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from track_before_detect.cli import main

MEASURED = """
import json, resource, sys
from track_before_detect.cli import main
code = main(sys.argv[1:])
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps([code, used.ru_utime + used.ru_stime, 1024 * used.ru_maxrss]))
"""


def planned(printed):
    """Return the cells of the last row of a table."""
    return printed.splitlines()[-1].split()


@pytest.mark.alone
def test_batches_time_and_memory_are_as_planned(tmp_path, capsys):
    path, output = str(tmp_path / 'a.npz'), str(tmp_path / 'out')
    frames = np.random.default_rng(1).standard_normal((120, 160, 200)).astype(np.float32)
    # A pause, and fewer frames than a whole hop at the end.
    stamps = np.arange(120) / 25
    stamps[67:] += 60
    np.savez(path, frames=frames, stamps=stamps)
    options = ['--preset', 'none', '--set', 'threshold=9', '--set', 'batch_length=20',
               '--set', 'hop=8', '--quiet']
    assert main(['plan', path, *options]) == 0
    n_batches, _, cpu_seconds, memory = planned(capsys.readouterr().out)[-4:]
    done = subprocess.run(
        [sys.executable, '-c', MEASURED, 'detect', path, *options, '--no-overlay',
         '--output', output], capture_output=True, text=True, timeout=300)
    code, used_seconds, used_bytes = json.loads(done.stdout.splitlines()[-1])
    assert code in (0, 3), done.stderr
    with open(os.path.join(output, 'summary.json')) as file:
        assert json.load(file)['n_batches'] == int(n_batches)
    assert used_seconds / 1.5 < float(cpu_seconds) < used_seconds * 1.5
    assert used_bytes / 1.5 < 1e9 * float(memory) < used_bytes * 1.5


def test_an_option_that_cannot_be_is_refused(tmp_path, capsys):
    np.savez(tmp_path / 'a.npz', frames=np.zeros((6, 8, 9)))
    assert main(['plan', str(tmp_path / 'a.npz'), '--set', 'hop=0']) == 2
    assert 'hop' in capsys.readouterr().err
