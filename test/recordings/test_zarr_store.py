"""Recordings in Zarr."""

import sys
import tracemalloc
import zipfile

import numpy as np
import pytest

from track_before_detect.cli import main
from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.zarr_store import CHUNK_BYTES, write_zarr_recording

zarr = pytest.importorskip('zarr')
FRAMES = np.random.default_rng(0).integers(0, 4000, (7, 6, 5)).astype(np.uint16)
STAMPS = np.arange(7) / 25


def write(path, zarr_format, chunks=(3, 4, 5)):
    store = zarr.storage.ZipStore(path, mode='w') if path.suffix == '.zip' else (
        zarr.storage.LocalStore(path))
    group = zarr.create_group(store, zarr_format=zarr_format)
    group.create_array('frames', data=FRAMES, chunks=chunks)
    group.create_array('stamps', data=STAMPS)
    store.close()
    return path


@pytest.mark.parametrize(('name', 'zarr_format'), [
    ('a.zarr', 2), ('a.zarr', 3), ('plain', 3), ('a.zarr.zip', 3)])
def test_frames_are_read_in_any_order(tmp_path, name, zarr_format):
    with open_recording(write(tmp_path / name, zarr_format)) as recording:
        assert recording.shape == (6, 5) and len(recording) == 7
        assert recording.dtype == np.uint16 and recording.stamps_known
        np.testing.assert_array_equal(recording.stamps, STAMPS)
        for index in (6, 0, 3, 2, 5, 1, 4):
            np.testing.assert_array_equal(recording[index], FRAMES[index])


def test_an_array_alone_has_no_stamps(tmp_path):
    zarr.save_array(str(tmp_path / 'b.zarr'), FRAMES)
    with open_recording(tmp_path / 'b.zarr', fps=10) as recording:
        np.testing.assert_array_equal(recording[3], FRAMES[3])
        assert recording.stamps[3] == pytest.approx(0.3)


def test_frames_of_a_rate_are_as_far_apart(tmp_path):
    group = zarr.create_group(str(tmp_path / 'a.zarr'))
    group.create_array('frames', data=FRAMES)
    group.create_array('fps', data=np.array(25.0))
    with open_recording(tmp_path / 'a.zarr') as recording:
        assert recording.stamps_known
        np.testing.assert_allclose(recording.stamps, STAMPS)
    group.create_array('fps', data=np.array([-1.0]), overwrite=True)
    with pytest.raises(DataError, match="'fps' of .* must be one positive number"):
        open_recording(tmp_path / 'a.zarr')


def test_what_is_no_recording_is_refused(tmp_path):
    zarr.create_group(str(tmp_path / 'empty.zarr'))
    zarr.save_array(str(tmp_path / 'flat.zarr'), FRAMES[0])
    (tmp_path / 'torn.zip').write_bytes(b'torn')
    for name, words in (('empty.zarr', "must hold an array 'frames'"),
                        ('flat.zarr', 'a single image'), ('torn.zip', 'no complete Zarr')):
        with pytest.raises(DataError, match=words):
            open_recording(tmp_path / name)


def test_a_flipped_byte_is_said_of_the_frame_it_lies_in(tmp_path):
    path = write(tmp_path / 'a.zip', 3, chunks=(1, 6, 5))
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        chunk = archive.getinfo('frames/c/4/0/0')
    for flipped in range(chunk.header_offset, chunk.header_offset + 60):
        damaged = bytearray(whole)
        damaged[flipped] ^= 0xff
        path.write_bytes(damaged)
        try:
            with open_recording(path) as recording:
                np.testing.assert_array_equal(list(recording), FRAMES)
        except DataError as error:
            assert 'frame 4 of' in str(error)
        else:
            # Dates and the like, which nobody reads.
            assert flipped < chunk.header_offset + 30


@pytest.mark.parametrize('suffix', ['.zarr', '.zip'])
@pytest.mark.parametrize('scenario', ['eo_ir_clouds', 'noise'])
def test_a_simulated_recording_is_that_of_npz(tmp_path, capsys, scenario, suffix):
    paths = [tmp_path / 'a.npz', tmp_path / f'a{suffix}']
    for path in paths:
        assert main(['simulate', scenario, '--seed', '4', '--output', str(path),
                     '--set', 'n_frames=6', '--set', 'height=40']) == 0
    with open_recording(paths[0]) as one, open_recording(paths[1]) as other:
        np.testing.assert_array_equal(list(other), list(one))
        np.testing.assert_array_equal(other.stamps, one.stamps)
        np.testing.assert_array_equal(other.truth, one.truth)


@pytest.mark.parametrize('name', ['a.zarr', 'a.zip'])
def test_no_more_than_a_chunk_and_what_is_written_of_it_is_held(tmp_path, name):
    frame = np.random.default_rng(0).standard_normal((512, 512))
    n_frames = 10 * CHUNK_BYTES // frame.nbytes + 1
    tracemalloc.start()
    write_zarr_recording(tmp_path / name, (frame + k for k in range(n_frames)),
                         np.arange(n_frames))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * CHUNK_BYTES
    with open_recording(tmp_path / name) as recording:
        np.testing.assert_array_equal(recording[n_frames - 1], frame + n_frames - 1)


def test_nothing_is_left_of_what_cannot_be_written(tmp_path):
    (tmp_path / 'there.zarr').mkdir()
    assert main(['simulate', 'noise', '--output', str(tmp_path / 'there.zarr')]) == 2
    with pytest.raises(DataError, match='8 stamps, got 7'):
        write_zarr_recording(tmp_path / 'short.zarr', FRAMES, np.arange(8))
    assert [path.name for path in tmp_path.iterdir()] == ['there.zarr']


def test_what_is_missing_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'zarr', None)
    assert main(['simulate', 'noise', '--output', str(tmp_path / 'a.zarr')]) == 2
    assert capsys.readouterr().err == (
        "tbd: error: writing Zarr needs zarr: pip install 'track_before_detect[zarr]'\n")
    assert not any(tmp_path.iterdir())
