"""``tbd view``: what is shown on rerun, read from the file that it saves."""

import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from track_before_detect.cli import main
from track_before_detect.recordings.overlay import real_picture
from track_before_detect.simulation.sensor import add_target
from views.page import make_clip, opened_page, RATE_HZ, wait_until_shown
from views.rows import rows_of

DATA = os.environ.get('TBD_DATA_DIR')
N_FRAMES, SHAPE = 8, (24, 40)
PROGRAM = 'import sys; from track_before_detect.cli import main; sys.exit(main(sys.argv[1:]))'


@pytest.fixture
def recording_file(tmp_path):
    """Return a file of frames in which a target moves by half a pixel a frame."""
    frames = np.random.default_rng(3).standard_normal((N_FRAMES, *SHAPE)).astype(np.float32)
    truth = [[t, 0, 10 + 0.5 * t, 12.0] for t in range(N_FRAMES)]
    for t, _, x, y in truth:
        add_target(frames[t], x, y, 1.0, 25.0)
    np.savez(tmp_path / 'a.npz', frames=frames, fps=25, truth=truth)
    return tmp_path / 'a.npz'


def test_frames_trajectories_truth_and_statistic_are_shown_over_time(
        recording_file, tmp_path, capsys):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    saved = tmp_path / 'a.rrd'
    assert main(['view', str(recording_file), '--preset', 'none', '--set', 'threshold=8',
                 '--save', str(saved)]) == 0
    assert f'written: {saved}' in capsys.readouterr().out
    rows = rows_of(saved)
    for name in ('frame', 'residual/none', 'matched_filter/none', 'frame/trajectories'):
        assert sorted(rows[f'/{name}']) == list(range(N_FRAMES)), name
    for frame in range(N_FRAMES):
        # The middle of the first pixel is at half a pixel there.
        where = np.array([10 + 0.5 * frame, 12]) + 0.5
        shown = rows['/frame/trajectories'][frame]
        np.testing.assert_allclose(shown['centers'], [where], atol=0.5)
        assert shown['labels'][0].startswith('1  ')
        np.testing.assert_allclose(rows['/frame/truth'][frame]['positions'], [where])
        assert len(rows['/frame/trails'][frame]['strips']) == (frame > 0)
        pixels = np.reshape(rows['/frame'][frame]['buffer'][0], SHAPE)
        y, x = np.unravel_index(pixels.argmax(), SHAPE)
        assert np.hypot(x + 0.5 - where[0], y + 0.5 - where[1]) < 2
    [value] = rows['/statistic/none/threshold'].values()
    assert value['scalars'] == [8]
    [value] = rows['/statistic/none/strongest_path'].values()
    assert value['scalars'][0] > 8


def test_a_result_is_shown_as_it_was_found_without_another_search(
        recording_file, tmp_path, capsys):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    output, saved = tmp_path / 'output', tmp_path / 'a.rrd'
    assert main(['detect', str(recording_file), '--preset', 'none', '--set', 'threshold=8',
                 '--no-overlay', '--output', str(output)]) == 0
    table = output / 'trajectories.csv'
    table.write_text(table.read_text().replace('\n1,', '\n7,'))
    capsys.readouterr()
    assert main(['view', str(output), '--save', str(saved)]) == 0
    assert capsys.readouterr().out.startswith('a.npz: 1 trajectories')
    rows = rows_of(saved)
    assert sorted(rows['/frame']) == list(range(N_FRAMES))
    for frame in range(N_FRAMES):
        shown = rows['/frame/trajectories'][frame]
        np.testing.assert_allclose(shown['centers'], [[10.5 + 0.5 * frame, 12.5]], atol=0.5)
        assert shown['labels'][0].startswith('7  ')


@pytest.mark.parametrize('told', [
    ['--fps', '5'], ['--topic', '/a'], ['--preset', 'none'], ['--set', 'threshold=9'],
    ['--detector', 'greedy']])
def test_what_changes_a_search_is_refused_beside_a_result(tmp_path, capsys, told):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    for name in ('summary.json', 'trajectories.csv'):
        (tmp_path / name).touch()
    assert main(['view', str(tmp_path), *told, '--save', str(tmp_path / 'a.rrd')]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert told[0] in line and 'is a result' in line


def real_clip():
    """Return frames of a camera that pans over a sky, and where a target is said to be."""
    if not DATA:
        pytest.skip('TBD_DATA_DIR names no folder of real recordings')
    with np.load(Path(DATA) / 'ir_istd_s4_sky_horizon.npz') as recording:
        return recording['frames'][:40], recording['truth'][:40, 2:]


@pytest.mark.parametrize(('make', 'told'), [
    (make_clip, ['--preset', 'none', '--set', 'background=temporal_median', '--set',
                 'noise=robust', '--set', 'threshold=12', '--set', 'batch_length=20']),
    (real_clip, [])], ids=['made', 'real'])
def test_a_page_shows_the_trajectory_of_a_clip_where_it_is(tmp_path, make, told):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    frames, positions = make()
    np.savez(tmp_path / 'clip.npz', frames=frames, fps=RATE_HZ)
    with subprocess.Popen(
            [sys.executable, '-c', PROGRAM, 'view', tmp_path / 'clip.npz', *told, '--web'],
            stdout=subprocess.PIPE, text=True) as command:
        try:
            address = command.stdout.readline().partition(' ')[0]
            with opened_page(address) as page:
                wait_until_shown(
                    page, real_picture(frames[-1]), positions[15:], 1, tmp_path)
        finally:
            command.terminate()


def test_a_result_whose_recording_is_gone_names_it(recording_file, tmp_path, capsys):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    output = tmp_path / 'output'
    main(['detect', str(recording_file), '--preset', 'none', '--set', 'threshold=8',
          '--no-overlay', '--output', str(output)])
    recording_file.unlink()
    assert main(['view', str(output), '--save', str(tmp_path / 'a.rrd')]) == 2
    assert str(recording_file) in capsys.readouterr().err


def test_without_rerun_the_extra_is_named(recording_file):
    program = ('import importlib.util, sys\n'
               'find = importlib.util.find_spec\n'
               'importlib.util.find_spec = lambda name: None if name == "rerun" else find(name)\n'
               'from track_before_detect.cli import main\n'
               f'sys.exit(main(["view", {str(recording_file)!r}]))')
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=60)
    assert done.returncode == 2
    assert 'track_before_detect[view]' in done.stderr and done.stderr.count('\n') == 1


@pytest.mark.parametrize(('arguments', 'fragment'), [
    (['--save', 'a.txt'], '--save must end with .rrd'), (['--save', 'no/such/a.rrd'], 'no/such')])
def test_a_file_that_cannot_be_saved_is_refused(recording_file, capsys, arguments, fragment):
    pytest.importorskip('rerun', reason='the extra [view] is missing')
    assert main(['view', str(recording_file), *arguments]) == 2
    assert fragment in capsys.readouterr().err
