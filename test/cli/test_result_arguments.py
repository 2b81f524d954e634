"""``tbd detect --formats``, ``--json`` and ``--video``."""

import json
import os

import numpy as np
import pytest

from track_before_detect.cli import main


def detect(*arguments):
    return main(['detect', '--preset', 'none', '--no-overlay', *map(str, arguments)])


def test_lines_of_json_are_all_that_is_printed(recording_file, stand_in, tmp_path, capsys):
    assert detect(recording_file, '--json', '-', '--output', tmp_path / 'out') == 0
    captured = capsys.readouterr()
    features = [json.loads(line) for line in captured.out.splitlines()]
    assert [feature['id'] for feature in features] == [1, 2]
    assert features[0]['geometry']['coordinates'][0] == [6.0, 6.0]
    assert features[0]['properties']['frames'] == [1, 2, 3, 4, 5]
    # Words for people are not lost, and files are written as always.
    assert '12.35' in captured.err and 'written: ' in captured.err
    assert sorted(os.listdir(tmp_path / 'out')) == ['summary.json', 'trajectories.csv']


def test_lines_of_several_recordings_name_theirs(stand_in, tmp_path, capsys):
    for name in 'ab':
        np.savez(tmp_path / f'{name}.npz', frames=np.zeros((6, 16, 20)))
    assert detect(tmp_path / '?.npz', '--json', '-', '--output', tmp_path / 'out') == 0
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line)['properties']['input'] for line in lines] == [
        'a.npz', 'a.npz', 'b.npz', 'b.npz']


def test_nothing_found_prints_no_line(recording_file, stand_in, tmp_path, capsys):
    stand_in.trajectories = 0
    assert detect(recording_file, '--json', '-', '--output', tmp_path / 'out') == 3
    assert capsys.readouterr().out == ''


def test_files_that_are_asked_for_are_written_together(recording_file, stand_in, tmp_path):
    pytest.importorskip('PIL', reason='the extra [video] is missing')
    assert detect(recording_file, '--formats', 'mot,coco,json', '--video', 'a.gif',
                  '--output', tmp_path / 'out') == 0
    assert sorted(os.listdir(tmp_path / 'out')) == [
        'a.gif', 'coco.json', 'mot.txt', 'summary.json', 'trajectories.csv', 'trajectories.jsonl']
    assert len((tmp_path / 'out' / 'mot.txt').read_text().splitlines()) == 2 * 5


@pytest.mark.parametrize(('arguments', 'fragments'), [
    (['--formats', 'cocoa'], ["unknown format 'cocoa'", 'did you mean coco']),
    (['--json', 'a.jsonl'], ["got 'a.jsonl'", '--formats json']),
    (['--video', 'x/a.mp4'], ['.mp4 or .gif', "'x/a.mp4'"])])
def test_what_cannot_be_written_is_refused_before_the_search(
        recording_file, stand_in, tmp_path, capsys, arguments, fragments):
    assert detect(recording_file, *arguments, '--output', tmp_path / 'out') == 2
    error = capsys.readouterr().err
    assert all(fragment in error for fragment in fragments)
    assert stand_in.options is None and not (tmp_path / 'out').exists()


@pytest.mark.parametrize('link', [False, True], ids=['file', 'link'])
def test_no_film_takes_the_place_of_its_recording(stand_in, tmp_path, capsys, link):
    pytest.importorskip('PIL', reason='the extra [video] is missing')
    recording = tmp_path / 'flight.gif'
    recording.write_bytes(b'frames of a flight')
    given = recording
    if link:
        given = tmp_path / 'elsewhere' / 'link.gif'
        given.parent.mkdir()
        given.symlink_to(recording)
    assert detect(given, '--output', tmp_path, '--video', 'flight.gif') == 2
    error = capsys.readouterr().err
    assert f'{recording} is an input' in error and '--output' in error
    assert recording.read_bytes() == b'frames of a flight'
    assert stand_in.options is None


def test_no_result_takes_the_place_of_another_recording(stand_in, tmp_path, capsys):
    folder = tmp_path / 'a'
    folder.mkdir()
    (folder / 'rejected.csv').write_bytes(b'given as an input')
    np.savez(tmp_path / 'a.npz', frames=np.zeros((6, 16, 20)))
    given = tmp_path / 'a.npz', folder / 'rejected.csv', '--output', tmp_path
    assert detect(*given, '--explain') == 2
    assert f'{folder / "rejected.csv"} is an input' in capsys.readouterr().err
    assert stand_in.options is None
    # A file that is not written threatens nothing: the other recording is searched.
    detect(*given)
    assert stand_in.options is not None
    assert (folder / 'rejected.csv').read_bytes() == b'given as an input'


@pytest.fixture(params=['a.mp4', 'a.gif'])
def too_wide(request, tmp_path):
    """Return a film, and a recording whose frames are too wide for it."""
    pytest.importorskip('PIL', reason='the extra [video] is missing')
    if request.param == 'a.mp4':
        pytest.importorskip('av', reason='the extra [video] is missing')
    np.savez(tmp_path / 'wide.npz', fps=10,
             frames=np.zeros((3, 1, 70000) if request.param == 'a.gif' else (3, 2, 17000)))
    return request.param, tmp_path / 'wide.npz'


def test_what_is_found_is_kept_and_printed_where_no_film_can_be_made_of_it(
        too_wide, stand_in, tmp_path, capsys):
    film, recording = too_wide
    assert detect(recording, '--video', film, '--output', tmp_path / 'out') == 2
    captured = capsys.readouterr()
    assert sorted(os.listdir(tmp_path / 'out')) == ['summary.json', 'trajectories.csv']
    assert len((tmp_path / 'out' / 'trajectories.csv').read_text().splitlines()) == 1 + 2 * 2
    assert captured.out.count('12.35') == 2 and 'written: ' in captured.out
    [error] = [line for line in captured.err.splitlines() if 'error' in line]
    assert f'{film} cannot be written: ' in error and '000 x ' in error


def test_of_several_recordings_that_without_its_film_is_said_to_have_failed(
        too_wide, stand_in, tmp_path, capsys):
    film, recording = too_wide
    np.savez(tmp_path / 'b.npz', frames=np.zeros((6, 16, 20)))
    assert detect(recording, tmp_path / 'b.npz', '--video', film, '--output',
                  tmp_path / 'out') == 2
    captured = capsys.readouterr()
    assert [line.split(': ')[1].split(',')[0] for line in captured.out.splitlines()] == [
        '2 trajectories'] * 2
    [error] = [line for line in captured.err.splitlines() if 'error' in line]
    assert f'{recording}: {film} cannot be written: ' in error
    assert (tmp_path / 'out' / 'wide' / 'trajectories.csv').exists()
    assert (tmp_path / 'out' / 'b' / film).exists()
