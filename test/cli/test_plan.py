"""``tbd plan``: what it expects is what a search then costs."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from track_before_detect.cli import main
from track_before_detect.cli.plan import Plan, spans_of, Tiles, together
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.tiled import TiledDetector
from track_before_detect.types import FrameBatch

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


def taken_by(arguments):
    """Return CPU seconds and largest memory in bytes of a search in a process of its own."""
    done = subprocess.run([sys.executable, '-c', MEASURED, 'detect', *arguments, '--no-overlay'],
                          capture_output=True, text=True, timeout=300)
    code, used_seconds, used_bytes = json.loads(done.stdout.splitlines()[-1])
    assert code in (0, 3), done.stderr
    return used_seconds, used_bytes


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
    used_seconds, used_bytes = taken_by([path, *options, '--output', output])
    with open(os.path.join(output, 'summary.json')) as file:
        assert json.load(file)['n_batches'] == int(n_batches)
    assert used_seconds / 1.5 < float(cpu_seconds) < used_seconds * 1.5
    assert used_bytes / 1.5 < 1e9 * float(memory) < used_bytes * 1.5


def test_an_option_that_cannot_be_is_refused(tmp_path, capsys):
    np.savez(tmp_path / 'a.npz', frames=np.zeros((6, 8, 9)))
    assert main(['plan', str(tmp_path / 'a.npz'), '--set', 'hop=0']) == 2
    assert 'hop' in capsys.readouterr().err


class Counted(ConvexDetector):
    """Remembers the sizes of what it searched."""

    def detect(self, batch, *others):
        self.shapes = [*getattr(self, 'shapes', ()), batch.frames.shape[1:]]
        return super().detect(batch, *others)


@pytest.mark.alone
def test_tiles_are_those_that_the_detector_searches(tmp_path, capsys):
    path, output = str(tmp_path / 'a.npy'), str(tmp_path / 'out')
    frames = np.random.default_rng(1).standard_normal((12, 600, 480)).astype(np.float32)
    np.save(path, frames)
    told = {'threshold': 9.0, 'tile_px': 160, 'batch_length': 8}
    options = ['--preset', 'none', '--quiet', *(
        word for name, value in told.items() for word in ('--set', f'{name}={value}'))]
    assert main(['plan', path, *options]) == 0
    *_, number, width, _, height, tile_memory, n_batches, _, cpu_seconds, memory = planned(
        capsys.readouterr().out)
    inner = Counted(DetectorOptions(**told))
    TiledDetector(DetectorOptions(**told), inner).detect(
        FrameBatch.of(frames[:8], np.arange(8.0)))
    assert inner.shapes == int(number) * [(int(height), int(width))]
    assert int(n_batches) == 2
    used_seconds, used_bytes = taken_by([path, *options, '--output', output])
    assert used_seconds / 1.5 < float(cpu_seconds) < used_seconds * 1.5
    assert used_bytes / 1.5 < 1e9 * float(memory) < used_bytes * 1.5
    assert float(tile_memory) <= float(memory)


def test_workers_take_the_next_recording_when_they_are_done():
    plans = [Plan(2, np.array([1.0, 1.5]), np.array([0.6, 1.0]) * seconds, memory)
             for seconds, memory in ((10, 3e8), (30, 1e8), (10, 2e8), (10, 2e8))]
    n_batches, times, memory = together(plans, 0, 0)
    assert (n_batches, memory) == (8, 3e8)
    np.testing.assert_allclose(times, [1 + 36, 1.5 + 60])
    n_batches, times, memory = together(plans, 2, 2)
    assert (n_batches, memory) == (8, 5e8)
    np.testing.assert_allclose(times, [1.5 + 30, 2 * 1.5 + 60])
    # A single core does the work of all of them, and the fifth worker has none.
    np.testing.assert_allclose(together(plans, 5, 1)[1], 2 * [4 * 1.5 + 60])


def test_a_single_recording_is_shared_out_in_parts_of_eight_batches():
    parts = spans_of(Plan(20, np.array([1.0, 1.5]), np.array([30.0, 40.0]), 1e9), 2)
    assert [part.n_batches for part in parts] == [8, 8, 4]
    n_batches, times, memory = together(parts, 2, 2)
    assert n_batches == 20 and memory == 2e9
    # The second worker searches 8 + 4 batches, or the first one does.
    np.testing.assert_allclose(times, [1.5 + 24, 2 * 1.5 + 40])


def test_the_tiles_of_a_recording_of_few_parts_are_shared_out_as_well():
    plan = Plan(12, np.array([1.0, 1.5]), np.array([30.0, 48.0]), 1e9, Tiles(16, (512, 512), 1e8))
    parts = spans_of(plan, 5)
    assert [part.n_batches for part in parts] == [8, 0, 0, 4, 0, 0]
    np.testing.assert_allclose(sum(part.search for part in parts), plan.search)
    # Five of them first, the last one by who has done the third of four batches.
    n_batches, times, memory = together(parts, 5, 5)
    assert n_batches == 12 and memory == 5e9
    np.testing.assert_allclose(times, [1.5 + 32 / 3, 5 * 1.5 + 48])
    assert len(spans_of(plan, 2)) == 2


def test_the_last_line_is_for_the_workers_that_are_told(tmp_path, capsys):
    np.save(tmp_path / 'a.npy', np.zeros((6, 16, 16)))
    arguments = ['plan', str(tmp_path / 'a.npy'), '--preset', 'none', '--set', 'threshold=9',
                 '--quiet', '--scheduler']
    assert main([*arguments, 'local', '--jobs', '2']) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert 'all, 2 workers' in last
    # How many there are at an address nobody asks.
    assert main([*arguments, 'tcp://there:8786']) == 2
    assert '--jobs' in capsys.readouterr().err
