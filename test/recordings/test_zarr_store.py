"""Recordings in Zarr."""

import numpy as np
import pytest

from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import open_recording

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


def test_what_is_no_recording_is_refused(tmp_path):
    zarr.create_group(str(tmp_path / 'empty.zarr'))
    zarr.save_array(str(tmp_path / 'flat.zarr'), FRAMES[0])
    (tmp_path / 'torn.zip').write_bytes(b'torn')
    for name, words in (('empty.zarr', "must hold an array 'frames'"),
                        ('flat.zarr', 'a single image'), ('torn.zip', 'no complete Zarr')):
        with pytest.raises(DataError, match=words):
            open_recording(tmp_path / name)
