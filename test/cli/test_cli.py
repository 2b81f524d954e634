import csv
import dataclasses
import importlib.util
import io
import json
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest

from track_before_detect.cli import main
from track_before_detect.cli.console import Progress
from track_before_detect.options import describe, DetectorOptions
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.results import folder as result_folder
from track_before_detect.simulation.scenarios import SCENARIOS
from track_before_detect.simulation.sensor import add_target

CONFIG = Path(__file__).parents[2] / 'config' / 'detector.param.yaml'


def run(*arguments):
    """Return the exit code of the command."""
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return stop.code


def assert_one_sentence(capsys, *fragments):
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert lines[-1].startswith('tbd: error: ')
    assert sum(line.startswith('tbd: error') for line in lines) == 1
    assert 'Traceback' not in captured.err
    for fragment in fragments:
        assert fragment in lines[-1]


def test_detect_finds_the_target_of_a_simulated_recording(tmp_path, capsys):
    recording = tmp_path / 'one.npz'
    # Of the size that the benchmarks calibrate in their tests.
    assert run('simulate', 'single_target', '--seed', 3, '--output', recording,
               '--set', 'snr=8', '--set', 'height=40', '--set', 'width=44',
               '--set', 'n_frames=6') == 0
    output = tmp_path / 'results' / 'one'
    assert run('detect', recording, '--output', output) == 0
    with open(output / 'trajectories.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    with open_recording(recording) as opened:
        truth = {int(frame): (x, y) for frame, _, x, y in opened.truth}
    assert [int(row['frame']) for row in rows] == list(range(6))
    for row in rows:
        x, y = truth[int(row['frame'])]
        assert np.hypot(float(row['x_px']) - x, float(row['y_px']) - y) < 1.5
    summary = json.loads((output / 'summary.json').read_text())
    assert summary['n_trajectories'] == 1
    assert float(rows[0]['statistic']) > summary['threshold']
    assert summary['threshold_source'] in ('model', 'cached')
    assert 'trajectories.csv' in capsys.readouterr().out


def test_detect_says_and_writes_which_frame_is_left_out(tmp_path, caplog):
    frames = np.random.default_rng(0).standard_normal((6, 16, 20))
    np.savez(tmp_path / 'a.npz', frames=frames, stamps=[0, 1, 2, 0, 4, 5])
    run('detect', tmp_path / 'a.npz', '--output', tmp_path / 'out', '--set', 'threshold=9',
        '--preset', 'none')
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    [remark] = summary['remarks']
    assert 'frame 3 is left out' in remark and remark in caplog.text
    assert summary['median_interval_s'] == 1


def test_detect_writes_all_files_and_prints_a_table(recording_file, stand_in, tmp_path, capsys):
    output = tmp_path / 'deep' / 'out'
    assert run('detect', recording_file, '--preset', 'none', '--output', output) == 0
    assert sorted(os.listdir(output)) == ['overlay.png', 'summary.json', 'trajectories.csv']
    out = capsys.readouterr().out.splitlines()
    assert out[0].split()[:2] == ['id', 'frames']
    assert out[1].split() == ['1', '1-5', '6.0,', '6.0', '10.0,', '6.0', '10.00', '3.20', '12.35']
    assert str(output / 'overlay.png') in out[-1]
    summary = json.loads((output / 'summary.json').read_text())
    assert summary['input'] == 'a.npz' and summary['detector'] == 'convex'
    assert summary['options'] == json.loads(json.dumps(dataclasses.asdict(stand_in.options)))
    assert (summary['threshold'], summary['status'], summary['gap']) == (8.5, 'converged', None)
    assert (summary['n_frames'], summary['n_trajectories']) == (6, 2)
    assert summary['remarks'] == []


def npz(path, n_frames=6, **arrays):
    np.savez(path, frames=np.random.default_rng(0).normal(size=(n_frames, 16, 20)), **arrays)
    return path


def test_made_up_stamps_are_said_and_speeds_are_per_frame(stand_in, tmp_path, capsys):
    path = npz(tmp_path / 'a.npz')
    stand_in.rejected = [(8.5 * 2, 'edge-like')]
    assert run('detect', path, '--explain', '--output', tmp_path / 'out', '--no-overlay') == 0
    printed = capsys.readouterr().out
    assert printed.count('speed [px/frame]') == 2 and 'px/s' not in printed
    with open_recording(path) as recording:
        [remark] = recording.remarks
    assert 'a.npz has no stamps: 1 frame is taken as 1 s' in remark
    assert 'px/frame' in remark and '--fps' in remark


def test_fps_gives_a_recording_its_stamps(stand_in, tmp_path, capsys):
    for name, arrays, n_remarks in (('without', {}, 0), ('with', {'fps': 10}, 1)):
        path = npz(tmp_path / f'{name}.npz', **arrays)
        output = tmp_path / name
        assert run('detect', path, '--output', output, '--no-overlay', '--fps', 20) == 0
        assert 'speed [px/s]' in capsys.readouterr().out
        summary = json.loads((output / 'summary.json').read_text())
        assert summary['stamps_known'] and summary['median_interval_s'] == pytest.approx(0.05)
        with open_recording(path, fps=20) as recording:
            np.testing.assert_allclose(recording.stamps, np.arange(6) / 20)
            assert len(recording.remarks) == n_remarks
    assert recording.remarks == ['20 frames/s as given, not the stamps of with.npz']


@pytest.mark.parametrize('rate', ['0', '-5', 'nan', 'fast'])
def test_fps_that_is_no_rate_is_refused(rate, tmp_path, capsys):
    assert run('detect', npz(tmp_path / 'a.npz'), '--output', tmp_path / 'out', '--fps', rate) == 2
    assert_one_sentence(capsys, '--fps', rate)
    assert not (tmp_path / 'out').exists()


def test_several_inputs_are_searched_whatever_becomes_of_one(stand_in, tmp_path, capsys):
    (tmp_path / 'day').mkdir()
    for k in (10, 9):
        npz(tmp_path / 'day' / f'{k}.npz')
    one, single = npz(tmp_path / 'b.npz'), npz(tmp_path / 'single.npz', n_frames=1)
    output = tmp_path / 'out'
    assert run('detect', one, single, tmp_path / 'day' / '*.npz', one, '--output', output,
               '--no-overlay') == 2
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert [Path(line.partition(':')[0]).name for line in lines] == ['b.npz', '9.npz', '10.npz']
    assert all('2 trajectories' in line for line in lines)
    errors = [line for line in captured.err.splitlines() if 'error' in line]
    assert len(errors) == 1 and 'single.npz' in errors[0] and '2 frames' in errors[0]
    assert sorted(os.listdir(output)) == ['10', '9', 'b']
    assert all((output / name / 'trajectories.csv').exists() for name in os.listdir(output))


def test_the_exit_code_of_several_inputs_says_whether_any_found(stand_in, tmp_path):
    paths = [npz(tmp_path / name) for name in ('a.npz', 'b.npz')]
    for trajectories, code in ((2, 0), (0, 3)):
        stand_in.trajectories = trajectories
        assert run('detect', *paths, '--output', tmp_path / 'out', '--no-overlay') == code


def test_inputs_of_the_same_name_have_folders_of_their_own(stand_in, tmp_path):
    for folder in ('x', 'y'):
        (tmp_path / folder).mkdir()
        npz(tmp_path / folder / 'a.npz')
    output = tmp_path / 'out'
    assert run('detect', tmp_path / '?' / 'a.npz', '--output', output, '--no-overlay') == 0
    assert len(list(output.rglob('trajectories.csv'))) == 2


def test_a_pattern_that_fits_one_file_is_that_file_and_none_is_refused(
        stand_in, tmp_path, capsys):
    npz(tmp_path / 'a[1].npz')
    for pattern in ('a*.npz', 'a[1].npz'):
        assert run('detect', tmp_path / pattern, '--output', tmp_path / 'out',
                   '--no-overlay') == 0
        assert (tmp_path / 'out' / 'trajectories.csv').exists()
    assert run('detect', tmp_path / '*.mp4', '--output', tmp_path / 'out') == 2
    assert_one_sentence(capsys, 'no file fits', '*.mp4')


def test_nothing_found_is_exit_code_3_with_the_header_alone(recording_file, stand_in, tmp_path):
    stand_in.trajectories = 0
    assert run('detect', recording_file, '--output', tmp_path / 'out') == 3
    assert len((tmp_path / 'out' / 'trajectories.csv').read_text().splitlines()) == 1
    assert (tmp_path / 'out' / 'overlay.png').exists()


def test_rejected_candidates_are_listed_when_asked_for(recording_file, stand_in, tmp_path, capsys):
    stand_in.rejected = [(8.5 * 0.9, 'below the threshold'), (8.5 * 2, 'edge-like')]
    assert run('detect', recording_file, '--output', tmp_path / 'plain') == 0
    assert '1 candidate rejected: tbd detect --explain' in capsys.readouterr().out
    assert not (tmp_path / 'plain' / 'rejected.csv').exists()
    assert run('detect', recording_file, '--explain', '--output', tmp_path / 'told') == 0
    printed = capsys.readouterr().out
    assert printed.index('edge-like') < printed.index('below the threshold')
    assert '2.00  ' in printed and '0.90  ' in printed
    with open(tmp_path / 'told' / 'rejected.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert [row['reason'] for row in rows] == ['edge-like'] * 5 + ['below the threshold'] * 5
    assert [row['trajectory_id'] for row in rows] == ['1'] * 5 + ['2'] * 5
    with open(tmp_path / 'told' / 'trajectories.csv', newline='') as file:
        assert 'reason' not in next(csv.reader(file))


def test_all_rejected_and_the_strongest_below_are_told(recording_file, stand_in, tmp_path):
    stand_in.rejected = [(8.5 * (2 - k / 50), 'edge-like') for k in range(100)]
    run('detect', recording_file, '--explain', '--output', tmp_path / 'out')
    with open(tmp_path / 'out' / 'rejected.csv', newline='') as file:
        assert len({row['trajectory_id'] for row in csv.DictReader(file)}) == 50 + 20


def test_nothing_found_says_how_near_the_best_came(recording_file, stand_in, tmp_path, capsys):
    stand_in.trajectories = 0
    stand_in.rejected = [(8.5 * 0.7, 'far below the threshold')]
    assert run('detect', recording_file, '--output', tmp_path / 'out') == 3
    assert 'reaches 0.70 of the threshold' in capsys.readouterr().out


def test_what_is_not_rejected_is_not_mentioned(recording_file, stand_in, tmp_path, capsys):
    stand_in.rejected = [(8.5 * 0.7, 'below the threshold')]
    assert run('detect', recording_file, '--output', tmp_path / 'out') == 0
    assert 'candidate' not in capsys.readouterr().out


def test_overlay_can_be_left_out(recording_file, stand_in, tmp_path):
    assert run('detect', recording_file, '--output', tmp_path / 'out', '--no-overlay') == 0
    assert sorted(os.listdir(tmp_path / 'out')) == ['summary.json', 'trajectories.csv']


def test_options_come_from_file_then_set_then_detector(recording_file, stand_in, tmp_path):
    config = tmp_path / 'flat.yaml'
    config.write_text('psf_sigma_px: 1.5\nfalse_alarm_rate: 0.01\ncontinuation: [1, 0]\n'
                      'threshold: null\n')
    assert run('detect', recording_file, '--output', tmp_path / 'out', '--config', config,
               '--set', 'false_alarm_rate=0.02', '--set', 'batch_length=4',
               '--detector', 'convex', '--set', 'hop=auto') == 0
    options = stand_in.options
    assert (options.psf_sigma_px, options.false_alarm_rate) == (1.5, 0.02)
    assert options.continuation == (1.0, 0.0)
    assert (options.batch_length, options.hop, options.threshold) == (4, None, None)


@pytest.mark.parametrize('node', ['/**', 'detector', '/radar/detector'])
def test_file_of_ros_parameters_is_read(recording_file, stand_in, tmp_path, capsys, node):
    config = tmp_path / 'ros.yaml'
    config.write_text(f'{node}:\n  ros__parameters:\n    noise: robust\n    threshold: 0.0\n'
                      '    batch_length: 0\n    frame_rate_hz: 30.0\n')
    assert run('detect', recording_file, '--output', tmp_path / 'out', '--config', config) == 0
    assert stand_in.options.noise == 'robust'
    assert stand_in.options.threshold is None and stand_in.options.batch_length is None
    assert 'frame_rate_hz' in capsys.readouterr().err


def test_parameter_file_of_the_node_can_be_used(recording_file, stand_in, tmp_path):
    assert run('detect', recording_file, '--output', tmp_path / 'out', '--config', CONFIG) == 0
    assert stand_in.options.detector == 'convex'


@pytest.mark.parametrize(('arguments', 'noise', 'psf_sigma_px'), [
    ([], 'local', 2.0), (['--preset', 'none'], 'local', 2.0),
    (['--set', 'noise=robust'], 'robust', 2.0)], ids=['file', 'none', 'set'])
def test_file_of_a_preset_is_used_and_what_is_told_wins(
        recording_file, stand_in, tmp_path, capsys, arguments, noise, psf_sigma_px):
    text = (CONFIG.parent / 'eoir_static.yaml').read_text()
    config = tmp_path / 'mine.yaml'
    config.write_text(text.replace('psf_sigma_px: 1.5', 'psf_sigma_px: 2.0'))
    assert run('detect', recording_file, '--output', tmp_path / 'out', '--config', config,
               *arguments) == 0
    options = stand_in.options
    assert (options.noise, options.psf_sigma_px) == (noise, psf_sigma_px)
    assert (options.background, options.registration) == ('either', 'none')
    assert 'not used here' not in capsys.readouterr().err


@pytest.mark.parametrize(
    ('arguments', 'fragments'),
    [(['--set', 'psf_sigma=2'], ["unknown option 'psf_sigma'", 'did you mean psf_sigma_px']),
     (['--set', 'psf_sigma_px'], ['KEY=VALUE', "'psf_sigma_px'"]),
     (['--set', 'psf_sigma_px=wide'], ["psf_sigma_px must be a number, got 'wide'"]),
     (['--set', 'psf_sigma_px=90'], ['at most 20 px, got 90']),
     (['--detector', 'convx'], ["got 'convx'", 'did you mean convex']),
     (['--detector', 'mff_dp', '--set', 'presence=partial'],
      ['mff_dp cannot honour presence=partial, only full: ']),
     (['--topic', '/image'], ['only a bag has topics']),
     (['--config', 'no.yaml'], ['no.yaml cannot be read']),
     (['--config', 'list.yaml'], ['must hold names and values, got a list']),
     (['--config', 'bad.yaml'], ['is not YAML']),
     (['--config', 'nested.yaml'], ['nested.yaml is not YAML with options: too many brackets']),
     (['--config', 'two.yaml'], ['ros__parameters of one node']),
     (['--config', 'unknown.yaml'], ["unknown option 'colour'"]),
     (['--output', 'list.yaml'], ['must be a folder', 'list.yaml']),
     (['--output', 'list.yaml/deeper'], ['must be a folder']),
     (['--nonsense'], ['--nonsense', 'see tbd'])])
def test_bad_option_is_one_sentence_exit_code_2_and_no_output(
        recording_file, stand_in, tmp_path, monkeypatch, capsys, arguments, fragments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'list.yaml').write_text('[1, 2]')
    (tmp_path / 'bad.yaml').write_text('a: [1\nb: }')
    (tmp_path / 'nested.yaml').write_text('a: ' + 100_000 * '[')
    (tmp_path / 'two.yaml').write_text('a: {ros__parameters: {}}\nb: {ros__parameters: {}}')
    (tmp_path / 'unknown.yaml').write_text('colour: red')
    before = sorted(os.listdir(tmp_path))
    assert run('detect', recording_file, *arguments) == 2
    assert_one_sentence(capsys, *fragments)
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.parametrize('name', [
    'missing.npz', 'empty.npz', 'cut.npz', 'text.txt', 'folder', 'one_frame.npz', 'nan.npz'])
def test_bad_input_is_one_sentence_exit_code_2_and_no_output(
        recording_file, tmp_path, capsys, name):
    (tmp_path / 'empty.npz').touch()
    (tmp_path / 'cut.npz').write_bytes(recording_file.read_bytes()[:500])
    (tmp_path / 'text.txt').write_text('hello')
    (tmp_path / 'folder').mkdir()
    np.savez(tmp_path / 'one_frame.npz', frames=np.zeros((1, 8, 8)))
    np.savez(tmp_path / 'nan.npz', frames=np.full((5, 8, 8), np.nan))
    assert run('detect', tmp_path / name, '--output', tmp_path / 'out') == 2
    assert_one_sentence(capsys, name)
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(('shape', 'fortran_order', 'arguments', 'words'), [
    ((6, 10_000, 10_000), False, [], '6 frames of 10000 x 10000 pixels at a time take 2.4 GB'),
    ((6, 10_000, 10_000), True, [], '6 frames of 10000 x 10000 pixels at a time take 2.4 GB'),
    ((600, 3000, 3000), False, ['--set', 'batch_length=60'], '60 frames of 3000 x 3000 pixels'),
])
def test_what_is_too_large_is_refused_before_it_is_unpacked(
        tmp_path, capsys, shape, fortran_order, arguments, words):
    path = tmp_path / 'huge.npz'
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {'descr': '<f4', 'fortran_order': fortran_order, 'shape': shape})
    np.savez(path, fps=25)
    # Of the pixels, which nobody may ask for, there is a directory entry alone.
    with zipfile.ZipFile(path, 'a', zipfile.ZIP_DEFLATED) as archive:
        archive.writestr('frames.npy', header.getvalue() + bytes(1000))
        archive.getinfo('frames.npy').file_size = 4 * math.prod(shape) + len(header.getvalue())
        archive.start_dir = archive.fp.tell()
    assert run('detect', path, '--output', tmp_path / 'out', *arguments) == 2
    assert_one_sentence(capsys, 'huge.npz is too large to search', words, 'lower batch_length')


@pytest.mark.parametrize(
    ('error', 'code', 'said'),
    [(KeyboardInterrupt(), 130, 'tbd: interrupted'),
     (MemoryError(), 2, 'tbd: error: not enough memory'),
     (OSError(28, 'No space left on device'), 2, 'No space left')])
def test_what_stops_the_search_leaves_no_output(
        recording_file, stand_in, tmp_path, capsys, error, code, said):
    stand_in.error = error
    assert run('detect', recording_file, '--output', tmp_path / 'out') == code
    assert said in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_signal_that_ends_the_run_while_it_writes_leaves_no_output(
        recording_file, stand_in, tmp_path, monkeypatch):
    output = tmp_path / 'out'
    monkeypatch.setattr(result_folder, 'write_summary_json',
                        lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert run('detect', recording_file, '--output', output) == 143
    finally:
        signal.signal(signal.SIGTERM, before)
    assert os.listdir(output) == []


def test_failure_while_writing_keeps_the_results_of_the_run_before(
        recording_file, stand_in, tmp_path, monkeypatch, capsys):
    output = tmp_path / 'out'
    assert run('detect', recording_file, '--output', output) == 0
    before = {file.name: file.read_bytes() for file in output.iterdir()}

    def disk_full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(result_folder, 'write_summary_json', disk_full)
    stand_in.trajectories = 1
    assert run('detect', recording_file, '--output', output) == 2
    assert {file.name: file.read_bytes() for file in output.iterdir()} == before


def test_files_of_the_run_before_are_removed_and_those_of_others_stay(
        recording_file, stand_in, tmp_path):
    pytest.importorskip('PIL', reason='the extra [video] is missing')
    output = tmp_path / 'out'
    output.mkdir()
    theirs = {'coco.json', 'b.gif', 'notes.txt', 'finished.jsonl'}
    for name in theirs:
        (output / name).write_text('theirs')
    more = ['--formats', 'mot', '--explain', '--video', 'a.gif']
    assert run('detect', recording_file, '--output', output, *more) == 0
    assert {'mot.txt', 'rejected.csv', 'a.gif', 'overlay.png'} < set(os.listdir(output))
    assert run('detect', recording_file, '--output', output, '--no-overlay') == 0
    assert set(os.listdir(output)) == {'summary.json', 'trajectories.csv', *theirs}
    assert {(output / name).read_text() for name in theirs} == {'theirs'}


@pytest.mark.parametrize('files', [['../a.gif', 'a.npz'], 'a.gif', None, [7]])
def test_no_file_is_removed_for_a_summary_of_something_else(
        recording_file, stand_in, tmp_path, files):
    output = tmp_path / 'out'
    output.mkdir()
    (output / 'summary.json').write_text(json.dumps({'files': files}))
    for path in (tmp_path / 'a.gif', output / 'a.npz'):
        path.touch()
    assert run('detect', recording_file, '--output', output, '--no-overlay') == 0
    assert (tmp_path / 'a.gif').exists() and (output / 'a.npz').exists()


def test_a_film_of_the_run_before_that_is_searched_itself_stays(stand_in, tmp_path):
    for package in ('PIL', 'av'):
        pytest.importorskip(package, reason='the extra [video] is missing')
    output, first = tmp_path / 'out', npz(tmp_path / 'a.npz')
    assert run('detect', first, '--output', output, '--no-overlay', '--video', 'a.mp4') == 0
    assert run('detect', output / 'a.mp4', '--output', output, '--no-overlay') == 0
    assert (output / 'a.mp4').exists()


@pytest.mark.parametrize(('command', 'inputs', 'output'), [
    ('detect', ['one'], 'one'), ('detect', ['one', 'two'], '.'), ('inspect', ['one'], 'one/')])
def test_results_among_the_images_of_an_input_are_refused(
        stand_in, tmp_path, monkeypatch, capsys, command, inputs, output):
    image_module = pytest.importorskip('PIL.Image')
    for name in ('one', 'two'):
        (tmp_path / name).mkdir()
        for k in range(3):
            image_module.new('L', (8, 8)).save(tmp_path / name / f'{k}.png')
    monkeypatch.chdir(tmp_path)
    assert run(command, *inputs, '--output', output) == 2
    assert_one_sentence(capsys, 'into one', '--output')
    assert sorted(os.listdir(tmp_path / 'one')) == ['0.png', '1.png', '2.png']
    assert stand_in.options is None
    # Beside them, as elsewhere, is no matter.
    assert run('detect', *inputs, '--output', 'one/found') == 0


def target_of_some_frames(path, n_frames, seen, amplitude=6.0):
    """Write noise with a target in the frames ``seen``."""
    frames = np.random.default_rng(1).standard_normal((n_frames, 24, 40)).astype(np.float32)
    for t in seen:
        add_target(frames[t], 8 + 0.3 * (t - seen[0]), 12.0, 1.0, amplitude)
    np.savez(path, frames=frames, fps=25)


@pytest.mark.parametrize(('n_frames', 'given', 'n_batches'), [
    (40, [], 1), (80, [], 7), (80, ['--set', 'batch_length=80'], 1),
    (80, ['--set', 'batch_length=40', '--set', 'hop=40'], 2)])
def test_a_long_recording_is_searched_in_batches(tmp_path, n_frames, given, n_batches):
    target_of_some_frames(tmp_path / 'a.npz', n_frames, range(n_frames))
    assert run('detect', tmp_path / 'a.npz', '--no-overlay', '--output', tmp_path / 'out',
               '--set', 'threshold=13', *given) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert (summary['n_batches'], summary['n_trajectories']) == (n_batches, 1)


def test_a_target_of_a_part_of_a_recording_has_the_rows_of_that_part(tmp_path):
    target_of_some_frames(tmp_path / 'a.npz', 120, range(33, 93))
    assert run('detect', tmp_path / 'a.npz', '--no-overlay', '--output', tmp_path / 'out',
               '--set', 'threshold=9') == 0
    with open(tmp_path / 'out' / 'trajectories.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert {row['trajectory_id'] for row in rows} == {rows[0]['trajectory_id']}
    frames = [int(row['frame']) for row in rows]
    assert abs(frames[0] - 33) <= 2 and abs(frames[-1] - 92) <= 2
    assert frames == list(range(frames[0], frames[-1] + 1))


def test_what_remains_below_the_threshold_is_told(tmp_path, capsys):
    np.savez(tmp_path / 'a.npz', frames=np.random.default_rng(0).standard_normal((8, 24, 24)))
    assert run('detect', tmp_path / 'a.npz', '--no-overlay', '--output', tmp_path / 'out',
               '--set', 'threshold=9') == 3
    best = json.loads((tmp_path / 'out' / 'summary.json').read_text())['best_statistic']
    assert 4 < best < 9
    printed = capsys.readouterr().out
    assert f'the best path has a statistic of {best:.2f}, the threshold is 9.00' in printed
    assert 'false_alarm_rate' not in printed and 'status' not in printed
    assert run('detect', tmp_path / 'a.npz', '--no-overlay', '--output', tmp_path / 'out',
               '--preset', 'none') == 3
    assert 'a larger false_alarm_rate lowers it' in capsys.readouterr().out


def test_frames_that_are_no_noise_end_with_what_to_set(tmp_path, capsys):
    frames = 8000 + 20 * np.random.default_rng(0).standard_normal((20, 48, 48))
    np.savez(tmp_path / 'a.npz', frames=frames)
    assert run('detect', tmp_path / 'a.npz', '--no-overlay', '--output', tmp_path / 'out',
               '--preset', 'none', '--set', 'noise=robust') == 3
    printed = capsys.readouterr().out
    assert 'status not_noise' in printed and 'set background=temporal_median' in printed
    assert json.loads((tmp_path / 'out' / 'summary.json').read_text())['status'] == 'not_noise'


def test_the_time_of_a_batch_is_limited_in_words(tmp_path, capsys):
    frames = 2.2 * np.random.default_rng(0).standard_normal((20, 64, 64))
    np.savez(tmp_path / 'a.npz', frames=frames)
    run('detect', tmp_path / 'a.npz', '--no-overlay', '--output', tmp_path / 'out',
        '--preset', 'none', '--set', 'threshold=9', '--set', 'max_time_s=0.3')
    assert 'status time_limit: left when max_time_s was up' in capsys.readouterr().out


@pytest.mark.parametrize(('number', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_long_search_is_left_at_once(tmp_path, number, code):
    # Half of the noise passes here and there, so that it is no matter of a short look.
    frames = 2.2 * np.random.default_rng(0).standard_normal((20, 192, 192))
    np.savez(tmp_path / 'a.npz', frames=frames.astype(np.float32))
    program = 'import sys; from track_before_detect.cli import main; sys.exit(main())'
    search = subprocess.Popen(
        [sys.executable, '-c', program, 'detect', str(tmp_path / 'a.npz'), '--no-overlay',
         '--preset', 'none', '--set', 'threshold=9', '--set', 'max_time_s=60',
         '--output', str(tmp_path / 'out')],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))
    try:
        while 'searching' not in search.stderr.readline():
            assert search.poll() is None
        time.sleep(1.5)
        search.send_signal(number)
        sent = time.monotonic()
        _, said = search.communicate(timeout=30)
    finally:
        search.kill()
    # Far from the minute that it would have gone on for, also beside other work.
    assert time.monotonic() - sent < 10
    assert search.returncode == code, said
    assert 'Traceback' not in said and not (tmp_path / 'out').exists()


def test_missing_extra_is_named_before_the_work(recording_file, stand_in, monkeypatch, capsys):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, 'find_spec',
                        lambda name: None if name == 'matplotlib' else find_spec(name))
    assert run('detect', recording_file) == 2
    assert_one_sentence(capsys, 'track_before_detect[plots]', '--no-overlay')
    assert stand_in.options is None


def test_progress_is_one_line_per_task_without_a_terminal(
        recording_file, stand_in, tmp_path, capsys):
    run('detect', recording_file, '--preset', 'none', '--output', tmp_path / 'out')
    assert capsys.readouterr().err.splitlines() == ['tbd: calibrating', 'tbd: searching']


def test_progress_is_a_bar_on_a_terminal():
    pytest.importorskip('tqdm')

    class Terminal:
        text = ''

        def isatty(self):
            return True

        def write(self, text):
            self.text += text

        def flush(self):
            pass

    terminal = Terminal()
    with Progress(terminal) as progress:
        for done in (0.0, 0.5, 1.0, 1.2):
            progress('calibrating', done)
        progress('searching', 0.0)
    assert 'calibrating' in terminal.text and 'searching' in terminal.text
    assert '\n' not in terminal.text


@pytest.mark.parametrize('name', SCENARIOS)
def test_simulated_recording_reads_back(name, tmp_path, capsys):
    path = tmp_path / 'made.npz'
    assert run('simulate', name, '--seed', 2, '--output', path, '--set', 'n_frames=5') == 0
    assert str(path) in capsys.readouterr().out
    with open_recording(path) as recording:
        assert len(recording) == 5 and recording.stamps_known
        assert len(recording.truth) == 5 * SCENARIOS[name].n_targets


def test_same_seed_writes_the_same_file(tmp_path):
    for name, seed in (('a', 1), ('b', 1), ('c', 2)):
        run('simulate', 'noise', '--seed', seed, '--output', tmp_path / f'{name}.npz')
    a, b, c = (np.load(tmp_path / f'{name}.npz')['frames'] for name in 'abc')
    assert (a == b).all() and (a != c).any()


@pytest.mark.parametrize(
    ('arguments', 'fragments'),
    [(['three_target'], ['did you mean three_targets']),
     (['noise', '--seed', '-1'], ['seed must be', '-1']),
     (['noise', '--seed', 'x'], ['--seed', "'x'"]),
     (['noise', '--set', 'snrr=1'], ['did you mean snr']),
     (['noise', '--output', 'a.csv'], ['.npz', 'a.csv']),
     (['noise', '--output', 'no/such/a.npz'], ['no/such', 'does not exist']),
     ([], ['SCENARIO'])])
def test_bad_simulation_is_one_sentence_and_no_output(
        tmp_path, monkeypatch, capsys, arguments, fragments):
    monkeypatch.chdir(tmp_path)
    assert run('simulate', *arguments) == 2
    assert_one_sentence(capsys, *fragments)
    assert os.listdir(tmp_path) == []


def test_lists_name_everything(capsys):
    assert run('detect', '--list-options') == 0
    options = capsys.readouterr().out
    assert run('simulate', '--list') == 0
    scenarios = capsys.readouterr().out
    assert all(f'  {option["name"]}' in options for option in describe())
    assert all(f'  {name}\n' in scenarios for name in SCENARIOS)


def test_help_and_version(capsys):
    for arguments in (['--help'], ['detect', '--help'], ['simulate', '--help'], ['--version']):
        assert run(*arguments) == 0
    assert run() == 2
    text = capsys.readouterr().out
    assert 'tbd detect drones.npz' in text and 'tbd simulate --list' in text


@pytest.mark.parametrize('closing', ['import sys; sys.stdout = None', 'import sys'])
def test_output_that_cannot_be_printed_is_no_error(tmp_path, closing):
    # Without a stream as after >&-, or with one that knows ASCII alone.
    path = tmp_path / '\u96f7.npz'
    program = (f'{closing}; from track_before_detect.cli import main; '
               f'sys.exit(main(["simulate", "noise", "--output", {ascii(str(path))}]))')
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          env={**os.environ, 'PYTHONIOENCODING': 'ascii'}, timeout=60)
    assert (done.returncode, done.stderr) == (0, '')
    assert path.exists()


def test_reader_that_stops_listening_is_no_error():
    program = ('import sys; from track_before_detect.cli import main; '
               'sys.exit(main(["simulate", "--list"]))')
    process = subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE)
    process.stdout.close()
    error = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 0
    assert error == b''


def scene_recording(path):
    """Write counts of a still scene that is brighter to one side, with noise."""
    noise = np.random.default_rng(5).standard_normal((12, 40, 44))
    np.savez(path, frames=(900 + 10 * noise + np.arange(44)).astype(np.uint16), fps=25)
    return path


def test_detect_says_and_writes_what_it_chose_by_itself(tmp_path, stand_in, capsys):
    output = tmp_path / 'out'
    run('detect', scene_recording(tmp_path / 'a.npz'), '--output', output, '--no-overlay')
    assert stand_in.options.calibration == 'clutter'
    summary = json.loads((output / 'summary.json').read_text())
    said = [line.removeprefix('preset auto: ')
            for line in capsys.readouterr().err.splitlines() if line.startswith('preset auto: ')]
    assert said
    assert summary['remarks'] == said
    assert summary['options']['calibration'] == 'clutter'


def test_detect_without_a_preset_searches_the_frames_as_they_are(tmp_path, stand_in, capsys):
    output = tmp_path / 'out'
    run('detect', scene_recording(tmp_path / 'a.npz'), '--preset', 'none', '--output', output,
        '--no-overlay')
    assert stand_in.options == DetectorOptions()
    assert json.loads((output / 'summary.json').read_text())['remarks'] == []
    assert 'preset' not in capsys.readouterr().err


def test_what_is_set_wins_over_a_preset(tmp_path, stand_in):
    config = tmp_path / 'a.yaml'
    config.write_text('hop: 3\n')
    run('detect', scene_recording(tmp_path / 'a.npz'), '--preset', 'eoir_moving',
        '--set', 'noise=robust', '--config', config, '--output', tmp_path / 'out', '--no-overlay')
    assert stand_in.options.search_plane == 'image'
    assert stand_in.options.noise == 'robust'
    assert stand_in.options.hop == 3


def test_detect_refuses_an_unknown_preset_and_names_the_nearest(recording_file, tmp_path, capsys):
    assert run('detect', recording_file, '--preset', 'eoir_statik',
               '--output', tmp_path / 'out') == 2
    assert_one_sentence(capsys, 'eoir_statik', 'eoir_static')
