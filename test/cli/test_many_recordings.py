"""Many recordings on the workers of a cluster."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from track_before_detect.cli import main
from track_before_detect.simulation.sensor import add_target

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


def run(*given):
    """Return exit code and what is said of errors, of a process: a cluster has its own threads."""
    program = 'import sys; from track_before_detect.cli import main; sys.exit(main(sys.argv[1:]))'
    done = subprocess.run(
        [sys.executable, '-c', program, *words(*given)], capture_output=True, text=True,
        timeout=300)
    return done.returncode, done.stderr


def test_workers_find_the_same_and_a_run_begun_again_does_what_is_missing(recordings, tmp_path):
    alone, shared = tmp_path / 'alone', tmp_path / 'shared'
    workers = ('--scheduler', 'local', '--jobs', '2')
    assert main(words(recordings, alone)) == 2
    code, said = run(recordings, shared, *workers)
    assert code == 2, said
    assert said.count('torn.npz is not a complete') == 1
    assert '4 of 4' in said and 's to go' in said
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
        '0', '1', '2', 'torn']
    assert [(shared / f'{number}' / 'summary.json').stat().st_mtime_ns == marks[number]
            for number in range(3)] == [True, False, True]


def test_a_scheduler_that_does_not_answer_is_named(recordings, tmp_path, capsys):
    assert main(['detect', str(recordings / '*.npz'), '--output', str(tmp_path / 'out'), *OPTIONS,
                 '--scheduler', 'nowhere://here']) == 2
    assert 'nowhere://here' in capsys.readouterr().err.splitlines()[-1]
