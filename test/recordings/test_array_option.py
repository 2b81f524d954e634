"""Options that are arrays: given in Python or as a file, compared by content, refused clearly."""

import dataclasses
import json
import pickle

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions, parse_option
from track_before_detect.recordings.result_files import write_summary_json

PSF = np.arange(15.0).reshape(3, 5)


@pytest.fixture
def files(tmp_path):
    np.save(tmp_path / 'psf.npy', PSF)
    np.savez(tmp_path / 'psf.npz', psf=PSF, other=np.zeros(3))
    np.savez(tmp_path / 'single.npz', anything=PSF)
    return tmp_path


@pytest.mark.parametrize('name', ['psf.npy', 'psf.npz', 'single.npz'])
def test_a_file_is_the_array_it_holds(files, name):
    from_file = DetectorOptions(psf=parse_option('psf', f' {files / name} '))
    assert from_file == DetectorOptions(psf=PSF) == DetectorOptions(psf=PSF.tolist())
    assert hash(from_file) == hash(DetectorOptions(psf=PSF))
    assert from_file != DetectorOptions(psf=PSF + 1)
    assert from_file != DetectorOptions()


@pytest.mark.parametrize(('name', 'other'), [('psf.npy', 'a.npz'), ('psf.npz', 'a.npy')])
def test_a_file_is_read_as_what_it_is_not_as_it_is_called(files, name, other):
    (files / name).rename(files / other)
    assert DetectorOptions(psf=str(files / other)) == DetectorOptions(psf=PSF)


def test_an_image_is_the_array_of_its_pixels(tmp_path):
    image = pytest.importorskip('PIL.Image')
    pixels = np.arange(15, dtype=np.uint8).reshape(3, 5)
    image.fromarray(pixels).save(tmp_path / 'psf.png')
    assert DetectorOptions(psf=str(tmp_path / 'psf.png')) == DetectorOptions(psf=pixels)


def test_options_with_arrays_are_replaced_copied_and_written(files, tmp_path):
    options = DetectorOptions(psf=str(files / 'psf.npy'), mask=PSF > 3)
    assert options.replace(hop=3).psf == options.psf
    assert pickle.loads(pickle.dumps(options)) == options
    write_summary_json(tmp_path / 'summary.json', dataclasses.asdict(options))
    written = json.loads((tmp_path / 'summary.json').read_text())
    assert written['psf'] == str(files / 'psf.npy')
    assert written['mask'] == 'array of shape (3, 5)'


def test_the_array_of_an_option_cannot_be_changed():
    given = PSF.copy()
    options = DetectorOptions(psf=given)
    given[:] = 0
    assert options.psf.array.any()
    with pytest.raises(ValueError, match='read-only'):
        options.psf.array[0, 0] = 1


@pytest.mark.parametrize(('value', 'words'), [
    ('nowhere.npy', 'nowhere.npy'), ('text.txt', '.npz'), ('broken.npz', 'broken.npz'),
    ('open.npy', 'open.npy'),
    ('empty.png', 'empty'), ('two.npz', 'psf'), (3.0, 'array'), ([['a']], 'array'),
    ([[1], [1, 2]], 'array'), (np.ones((3, 3), complex), 'real')])
def test_what_is_no_array_is_refused_in_one_sentence(tmp_path, value, words):
    if isinstance(value, str):
        for name in ('text.txt', 'broken.npz', 'empty.png'):
            (tmp_path / name).write_bytes(b'' if name == 'empty.png' else b'PK nothing')
        np.savez(tmp_path / 'two.npz', a=PSF, b=PSF)
        np.save(tmp_path / 'open.npy', PSF)
        unclosed = (tmp_path / 'open.npy').read_bytes().replace(b')', b' ', 1)
        (tmp_path / 'open.npy').write_bytes(unclosed)
        value = str(tmp_path / value)
    with pytest.raises(ParameterError, match=words) as error:
        DetectorOptions(psf=value)
    assert len(str(error.value).splitlines()) == 1
