"""Many recordings, and one long one, on the workers of a cluster."""

from concurrent.futures import ThreadPoolExecutor
import json
import os
import shutil
import subprocess
import sys
import threading

import numpy as np
import pytest

from track_before_detect.cli import main
from track_before_detect.cli.spread.spans import changes_of
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.saved import Opened
from track_before_detect.simulation.sensor import add_target

# Ends a process that opens a file named so: always, or unless another has ended before.
DEADLY = """
import os, pathlib, signal, sys

def end(event, arguments):
    if event != 'open' or not isinstance(arguments[0], str):
        return
    mark = pathlib.Path(arguments[0]).parent / 'one_has_died'
    once = arguments[0].endswith('deadly_once.npz') and not mark.exists()
    if once:
        mark.touch()
    if once or arguments[0].endswith('deadly.npz'):
        os.kill(os.getpid(), signal.SIGKILL)

if any('worker' in word or 'spawn' in word for word in sys.argv + sys.orig_argv):
    sys.addaudithook(end)
"""
OPTIONS = ('--preset', 'none', '--set', 'threshold=8', '--no-overlay', '--formats', 'json')


@pytest.fixture
def recordings(tmp_path):
    """Return a folder of recordings in two formats, one without a target, and of no recording."""
    pytest.importorskip('distributed')
    folder = tmp_path / 'in'
    folder.mkdir()
    for number in range(3):
        frames = np.random.default_rng(number).standard_normal((6, 32, 32)).astype(np.float32)
        for k in range(6 if number else 0):
            add_target(frames[k], 8 + 0.6 * k, 9.0 + number, 1.0, 9.0)
        if number == 1:
            np.save(folder / '1.npy', frames)
        else:
            np.savez(folder / f'{number}.npz', frames=frames, fps=25)
    (folder / 'torn.npz').write_bytes(b'torn')
    return folder


def words(folder, output, *more):
    return ['detect', str(folder / '*.np*'), '--output', str(output), *OPTIONS, *more]


def run(*given, deadly=None):
    """Return exit code and what is said of errors, of a process: a cluster has its own threads.

    Its workers find a module that ends them in the folder ``deadly``.
    """
    program = 'import sys; from track_before_detect.cli import main; sys.exit(main(sys.argv[1:]))'
    done = subprocess.run(
        [sys.executable, '-c', program, *words(*given)], capture_output=True, text=True,
        timeout=300, env=os.environ | ({} if deadly is None else {'PYTHONPATH': os.pathsep.join(
            [str(deadly), *filter(None, [os.environ.get('PYTHONPATH')])])}))
    return done.returncode, done.stderr


def test_workers_find_the_same_and_a_run_begun_again_does_what_is_missing(recordings, tmp_path):
    alone, shared = tmp_path / 'alone', tmp_path / 'shared'
    workers = ('--scheduler', 'local', '--jobs', '1')
    assert main(words(recordings, alone)) == 2
    deadly = tmp_path / 'deadly'
    deadly.mkdir()
    (deadly / 'sitecustomize.py').write_text(DEADLY)
    shutil.copy(recordings / '0.npz', recordings / 'deadly.npz')
    code, said = run(recordings, shared, *workers, deadly=deadly)
    assert code == 2, said
    assert said.count('torn.npz is not a complete') == 1
    assert said.count('deadly.npz: every worker that searched it died') == 1
    assert '5 of 5' in said and 's to go' in said
    names = [f'{number}/trajectories.{kind}' for number in range(3) for kind in ('csv', 'jsonl')]
    assert all((alone / name).read_bytes() == (shared / name).read_bytes() for name in names)
    summaries = [json.loads((shared / f'{number}' / 'summary.json').read_text())
                 for number in range(3)]
    assert [one['n_trajectories'] for one in summaries] == [0, 1, 1]

    # What is there is kept; what is missing or has changed is searched.
    marks = {number: (shared / f'{number}' / 'summary.json').stat().st_mtime_ns
             for number in range(3)}
    shutil.rmtree(shared / '1')
    shutil.copy(recordings / '0.npz', recordings / 'torn.npz')
    code, said = run(recordings, shared, '--scheduler', 'local', '--jobs', '1')
    assert code == 0, said
    assert sorted(path.name for path in shared.iterdir() if path.is_dir()) == [
        '0', '1', '2', 'deadly', 'torn']
    assert [(shared / f'{number}' / 'summary.json').stat().st_mtime_ns == marks[number]
            for number in range(3)] == [True, False, True]


def test_one_recording_is_searched_in_parts_that_are_kept(tmp_path):
    pytest.importorskip('distributed')
    (tmp_path / 'sitecustomize.py').write_text(DEADLY)
    frames = np.random.default_rng(1).standard_normal((120, 24, 40)).astype(np.float32)
    for k, frame in enumerate(frames):
        add_target(frame, 4 + 0.25 * k, 9.0, 1.0, 9.0)
    np.savez(tmp_path / 'deadly_once.npz', frames=frames)
    options = ('--set', 'batch_length=8')
    alone, shared = tmp_path / 'alone', tmp_path / 'shared'
    assert main([*words(tmp_path, alone), *options]) == 0
    workers = ('--scheduler', 'local', '--jobs', '2')
    code, said = run(tmp_path, shared, *options, *workers, deadly=tmp_path)
    assert code == 0, said
    assert (tmp_path / 'one_has_died').exists()
    # 29 batches.
    assert 'of 4, about' in said and '4 of 4' in said
    found = (alone / 'trajectories.csv').read_bytes()
    assert found.count(b'\n') > 100
    assert (shared / 'trajectories.csv').read_bytes() == found
    done = (shared / 'finished.jsonl').read_text().split()
    (shared / 'trajectories.csv').unlink()
    code, said = run(tmp_path, shared, *options, *workers[:2], '--jobs', '1')
    assert code == 0, said
    assert (shared / 'trajectories.csv').read_bytes() == found
    assert (shared / 'finished.jsonl').read_text().split() == done


@pytest.mark.parametrize('command', ['detect', 'plan'])
def test_workers_without_a_scheduler_are_refused(tmp_path, capsys, command):
    assert main([command, str(tmp_path / 'a.npz'), '--jobs', '4']) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert '--jobs 4' in line and '--scheduler' in line


def test_a_scheduler_that_does_not_answer_is_named(recordings, tmp_path, capsys):
    assert main(['detect', str(recordings / '*.npz'), '--output', str(tmp_path / 'out'), *OPTIONS,
                 '--scheduler', 'nowhere://here']) == 2
    assert 'nowhere://here' in capsys.readouterr().err.splitlines()[-1]


class ThreadsOfReads:
    """Frames that know which threads have read them, and whether they were closed."""

    def __init__(self):
        self.threads, self.is_closed = set(), False

    def read(self, index):
        self.threads.add(threading.get_ident())
        return np.full((4, 5), float(index))

    def close(self):
        self.is_closed = True


def test_threads_of_a_worker_read_recordings_of_their_own(monkeypatch):
    sources = []

    def opened(_):
        sources.append(ThreadsOfReads())
        return Recording('a', (4, 5), np.float64, 9, sources[-1])

    monkeypatch.setattr(Opened, 'open', opened)
    both_run = threading.Barrier(2, timeout=60)

    def search_parts(_):
        for frames in ([0, 1, 2], [5, 4, 7]):
            both_run.wait()
            changes_of({'path': 'a', 'topic': None, 'fps': None, 'files': [[1, 2]],
                        'frames': frames})
        both_run.wait()
        # The file is another one: that before is closed.
        changes_of({'path': 'a', 'topic': None, 'fps': None, 'files': [[1, 3]], 'frames': [0, 1]})

    with ThreadPoolExecutor(2) as threads:
        list(threads.map(search_parts, range(2)))
    assert len(sources) == 4
    assert all(len(source.threads) == 1 for source in sources)
    assert len({*sources[0].threads, *sources[1].threads}) == 2
    assert [source.is_closed for source in sources] == [True, True, False, False]
