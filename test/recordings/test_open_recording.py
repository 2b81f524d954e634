import io
import logging
import os
from pathlib import Path
import tempfile
import weakref
import zipfile

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
import numpy as np
import pytest

from track_before_detect.errors import DataError
from track_before_detect.recordings.images import natural_key
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.read_errors import gathered_warnings, reader_module
from track_before_detect.recordings.recording import CACHE_BYTES, Recording

RNG = np.random.default_rng(20)
FRAMES = RNG.normal(100, 30, (5, 7, 6))
DATA_DIR = os.environ.get('TBD_DATA_DIR')


def all_frames(recording):
    return np.stack([recording[k] for k in range(len(recording))])


def refuse(path, message, topic=None):
    """Assert that opening and reading ``path`` fails with one sentence."""
    with pytest.raises(DataError, match=message) as caught:
        with open_recording(path, topic) as recording:
            all_frames(recording)
    assert '\n' not in str(caught.value)


DTYPES = st.sampled_from(
    [f'{order}{kind}' for order in '<>' for kind in ('u1', 'u2', 'i2', 'f4', 'f8', 'c8')])


@settings(deadline=None)
@given(DTYPES, hnp.array_shapes(min_dims=3, max_dims=3, max_side=6), st.booleans(), st.booleans(),
       st.data())
def test_npz_gives_back_what_was_saved(dtype, shape, compressed, fortran, data):
    frames = data.draw(hnp.arrays(np.dtype(dtype), shape))
    stored = np.asfortranarray(frames) if fortran else frames
    order = data.draw(st.lists(st.integers(0, shape[0] - 1), max_size=8))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.npz'
        (np.savez_compressed if compressed else np.savez)(path, frames=stored)
        with open_recording(path) as recording:
            assert recording.dtype.isnative
            np.testing.assert_array_equal(all_frames(recording), frames)
        with open_recording(path) as recording:
            for k in order:
                np.testing.assert_array_equal(recording[k], frames[k])


@settings(deadline=None)
@given(st.lists(st.floats(0.001, 100.0), min_size=1, max_size=6),
       hnp.arrays(np.float64, st.tuples(st.integers(0, 5), st.just(4)),
                  elements=st.floats(-1e6, 1e6)))
def test_written_recording_reads_back(intervals, truth):
    stamps = np.cumsum(intervals)
    frames = np.zeros((len(stamps), 2, 3), np.float32)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.npz'
        write_npz_recording(path, frames, stamps, truth)
        with open_recording(path) as recording:
            np.testing.assert_array_equal(recording.stamps, stamps)
            np.testing.assert_array_equal(recording.truth, truth)
            assert recording.stamps_known


def test_stamps_come_from_stamps_then_fps_then_one_second(tmp_path):
    cases = {'stamps': {'stamps': [5, 7, 8, 9, 11], 'fps': 25}, 'fps': {'fps': 25.0},
             'slow': {'fps': 2.0**-14}, 'none': {}}
    expected = {'stamps': [5, 7, 8, 9, 11], 'fps': [0, .04, .08, .12, .16],
                'slow': 2**14 * np.arange(5), 'none': [0, 1, 2, 3, 4]}
    for name, arrays in cases.items():
        path = tmp_path / f'{name}.npz'
        np.savez(path, frames=FRAMES, **arrays)
        with open_recording(path) as recording:
            np.testing.assert_allclose(recording.stamps, expected[name], rtol=1e-12)
            assert recording.stamps_known == (name != 'none')
            assert recording.truth is None


class CountedSource:
    """Makes frames, and tells which were asked for and which are still held."""

    def __init__(self, shape):
        self.shape = shape
        self.asked, self.made = [], []

    def read(self, index):
        frame = np.zeros(self.shape, np.float32)
        frame[0, 0] = index
        self.asked.append(index)
        self.made.append(weakref.ref(frame))
        return frame

    def close(self):
        pass

    def n_held(self):
        return sum(frame() is not None for frame in self.made)


def test_long_recording_is_not_held_in_memory():
    shape = (2048, 1024)
    source = CountedSource(shape)
    with Recording('long', shape, np.float32, 60, source) as recording:
        for start in range(0, 50, 5):
            for k in range(start, start + 10):
                assert recording[k][0, 0] == k
        assert 10 <= source.n_held() <= CACHE_BYTES // (4 * shape[0] * shape[1])
    assert source.n_held() == 0


def test_overlapping_batches_read_a_frame_once():
    source = CountedSource((7, 6))
    with Recording('short', (7, 6), np.float32, 5, source) as recording:
        for k in (0, 1, 2, 1, 2, 3, 2, 3, 4):
            recording[k]
    assert source.asked == [0, 1, 2, 3, 4]


def test_index_counts_from_the_end_and_is_bounded(tmp_path):
    path = tmp_path / 'a.npz'
    np.savez(path, frames=FRAMES)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[-1], FRAMES[-1])
        with pytest.raises(IndexError, match='0 to 4'):
            recording[5]
        assert len(list(recording)) == 5


@pytest.mark.parametrize(
    ('arrays', 'message'),
    [({'images': FRAMES}, "array 'frames'.*found images"),
     ({'frames': FRAMES[0]}, 'a single image of shape'),
     ({'frames': FRAMES[None]}, '4 dimensions'),
     ({'frames': FRAMES[:0]}, 'holds no frames'),
     ({'frames': FRAMES[:, :0]}, 'no pixels'),
     ({'frames': FRAMES.astype(str)}, 'must be numbers'),
     ({'frames': FRAMES.astype(object)}, 'must be numbers'),
     ({'frames': FRAMES > 100}, 'must be numbers'),
     ({'frames': np.zeros((512, 640, 20), np.uint8)}, r'looks like \(H, W, T\): np.moveaxis'),
     ({'frames': FRAMES, 'stamps': [0, 1, 2, 3]}, r'one stamp per frame \(5\).*\(4,\)'),
     ({'frames': FRAMES, 'stamps': np.full(5, np.nan)}, 'finite, got nan at frame 0'),
     ({'frames': FRAMES, 'stamps': list('abcde')}, 'real numbers'),
     ({'frames': FRAMES, 'fps': 0}, "'fps'.*positive"),
     ({'frames': FRAMES, 'fps': [1.0, 2.0]}, "'fps'.*positive"),
     ({'frames': FRAMES, 'truth': np.zeros((3, 3))}, 'rows .*shape .3, 3.'),
     ({'frames': FRAMES, 'truth': np.full((3, 4), np.inf)}, 'truth.*finite'),
     ({'frames': FRAMES, 'stamps': np.array([None] * 5)}, "'stamps'.*cannot be read")])
def test_bad_archive_is_refused_in_one_sentence(tmp_path, arrays, message):
    path = tmp_path / 'bad.npz'
    np.savez(path, **arrays)
    refuse(path, message)


@settings(deadline=None)
@given(DTYPES, hnp.array_shapes(min_dims=3, max_dims=3, max_side=6), st.booleans(), st.data())
def test_npy_gives_back_what_was_saved(dtype, shape, fortran, data):
    frames = data.draw(hnp.arrays(np.dtype(dtype), shape))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.npy'
        np.save(path, np.asfortranarray(frames) if fortran else frames)
        with open_recording(path) as recording:
            assert recording.dtype.isnative and not recording.stamps_known
            np.testing.assert_array_equal(all_frames(recording), frames)


@pytest.mark.parametrize(('array', 'message'), [
    (FRAMES[0], 'array of .*bad.npy must be .T, H, W., got a single image of shape'),
    (FRAMES[:0], 'holds no frames'), (FRAMES.astype(str), 'must be numbers'),
    (FRAMES.astype(object), 'not a complete .npy array'),
    (np.zeros((512, 640, 20), np.uint8), r'looks like \(H, W, T\): np.moveaxis')])
def test_bad_npy_is_refused_in_one_sentence(tmp_path, array, message):
    path = tmp_path / 'bad.npy'
    np.save(path, array)
    refuse(path, message)


def test_every_truncation_of_an_npy_is_refused(tmp_path):
    path = tmp_path / 'cut.npy'
    np.save(path, FRAMES)
    data = path.read_bytes()
    for length in (1, 10, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        refuse(path, 'not a complete .npy array')


def test_an_archive_with_the_name_of_an_array_is_refused_with_the_name_it_should_have(tmp_path):
    np.savez(tmp_path / 'a.npz', frames=FRAMES)
    refuse((tmp_path / 'a.npz').rename(tmp_path / 'a.npy'),
           'a.npy must be an array, found an archive: give it a name that ends with .npz')


@pytest.mark.parametrize('suffix', ['.npy', '.npz'])
def test_a_header_whose_bracket_never_closes_is_refused(tmp_path, suffix):
    written = io.BytesIO()
    np.save(written, FRAMES)
    path = tmp_path / f'open{suffix}'
    damaged = written.getvalue().replace(b')', b' ', 1)
    if suffix == '.npy':
        path.write_bytes(damaged)
    else:
        with zipfile.ZipFile(path, 'w') as archive:
            archive.writestr('frames.npy', damaged)
    refuse(path, f'open{suffix}')


@pytest.mark.parametrize('stamps', [[0, 1, 1, 3, 4], [0, 1, np.nan, 3, 4], [9, 1, 2, 3, 4]])
def test_stamps_that_do_not_increase_are_kept_for_the_search_to_set_aside(tmp_path, stamps):
    np.savez(tmp_path / 'a.npz', frames=FRAMES, stamps=stamps)
    with open_recording(tmp_path / 'a.npz') as recording:
        np.testing.assert_array_equal(recording.stamps, stamps)


def test_nanoseconds_are_read_as_such_and_said(tmp_path):
    stamps = 1_700_000_000_000_000_000 + 40_000_000 * np.arange(5)
    np.savez(tmp_path / 'a.npz', frames=FRAMES, stamps=stamps)
    with open_recording(tmp_path / 'a.npz') as recording:
        np.testing.assert_allclose(np.diff(recording.stamps), 0.04, rtol=1e-5)
        assert recording.remarks == ['stamps of a.npz are read as nanoseconds']


def test_a_given_rate_takes_back_what_was_said_of_stamps_and_nothing_else():
    for stamps, said in ((None, 0), (1e9 * (1.7e9 + np.arange(5)), 1), (np.arange(5), 1)):
        recording = Recording('a', FRAMES.shape[1:], FRAMES.dtype, 5, None, stamps)
        recording.remarks.append('3 images of a are left out')
        recording.set_rate(10)
        assert recording.remarks[said:] == ['3 images of a are left out']
        assert all('10 frames/s as given' in remark for remark in recording.remarks[:said])
        # A second rate takes the place of the first, or of none.
        recording.set_rate(20)
        assert [remark[:9] for remark in recording.remarks] == ['20 frames', '3 images ']


def test_every_truncation_of_an_archive_is_refused(tmp_path):
    whole = tmp_path / 'whole.npz'
    np.savez_compressed(whole, frames=FRAMES, stamps=np.arange(5))
    data = whole.read_bytes()
    path = tmp_path / 'cut.npz'
    for length in (1, 10, 100, len(data) // 2, len(data) - 30, len(data) - 1):
        path.write_bytes(data[:length])
        refuse(path, 'not a complete .npz archive')


@settings(deadline=None)
@given(st.binary(max_size=60),
       st.sampled_from(['.npz', '.npy', '.tif', '.fits', '.fits.gz', '.db3', '.mcap']))
def test_random_bytes_are_refused(content, suffix):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f'noise{suffix}'
        path.write_bytes(content)
        refuse(path, 'noise')


def test_whoever_ends_first_takes_no_warning_from_those_who_gather_on():
    reader_module('json', 'json', 'JSON')
    one, other = gathered_warnings(), gathered_warnings()
    heard = one.__enter__()
    other.__enter__()
    other.__exit__(None, None, None)
    logging.getLogger('json').warning('an odd value')
    one.__exit__(None, None, None)
    assert heard == ['an odd value']


def test_damaged_frame_is_refused(tmp_path):
    path = tmp_path / 'a.npz'
    np.savez_compressed(path, frames=RNG.normal(size=(20, 30, 30)))
    data = bytearray(path.read_bytes())
    data[len(data) // 2:len(data) // 2 + 100] = b'\0' * 100
    path.write_bytes(bytes(data))
    refuse(path, 'cannot be read')


@pytest.mark.parametrize('fortran_order', [False, True])
@pytest.mark.parametrize('shape', [(2**62, 8, 8), (10**4, 10**4, 10**4), (-4, 8, 8)])
def test_shape_that_the_archive_cannot_hold_is_refused_before_it_is_read(
        tmp_path, shape, fortran_order):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {'descr': '<f4', 'fortran_order': fortran_order, 'shape': shape})
    path = tmp_path / 'boast.npz'
    with zipfile.ZipFile(path, 'w') as archive:
        archive.writestr('frames.npy', header.getvalue() + bytes(1000))
    refuse(path, "array 'frames' of .*boast.npz cannot be read: shape .* bytes, got 1000$")


def test_stamps_that_the_archive_cannot_hold_are_refused_before_they_are_read(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {'descr': '<f8', 'fortran_order': False, 'shape': (10**12,)})
    path = tmp_path / 'boast.npz'
    np.savez(path, frames=FRAMES)
    with zipfile.ZipFile(path, 'a') as archive:
        archive.writestr('stamps.npy', header.getvalue())
    refuse(path, "array 'stamps' of .* needs 8000000000000 bytes, got 0$")


def test_stamps_without_end_are_refused_before_they_are_read(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {'descr': '|u1', 'fortran_order': False, 'shape': (10**7 + 1,)})
    path = tmp_path / 'zeros.npz'
    np.savez(path, frames=FRAMES)
    with zipfile.ZipFile(path, 'a', zipfile.ZIP_DEFLATED) as archive:
        archive.writestr('stamps.npy', header.getvalue() + bytes(10**7 + 1))
    refuse(path, r"'stamps' of .* at most 10000000 values, got shape \(10000001,\)$")


def test_array_shorter_than_its_header_says_is_refused(tmp_path):
    path = tmp_path / 'short.npz'
    np.save(tmp_path / 'frames.npy', FRAMES)
    with zipfile.ZipFile(path, 'w') as archive:
        archive.writestr('frames.npy', (tmp_path / 'frames.npy').read_bytes()[:-9])
    refuse(path, 'needs 1680 bytes, got 1671')


@pytest.mark.parametrize(
    ('name', 'message'),
    [('missing.npz', 'does not exist'), ('notes.txt', 'unknown kind'),
     ('photo.png', 'single image'), ('zero.npz', 'is empty')])
def test_unusable_path_is_refused(tmp_path, name, message):
    for existing in ('notes.txt', 'photo.png', 'zero.npz'):
        (tmp_path / existing).touch()
    refuse(tmp_path / name, message)


def test_topic_of_what_is_no_bag_is_refused(tmp_path):
    path = tmp_path / 'a.npz'
    np.savez(path, frames=FRAMES)
    refuse(path, 'only a bag has topics', topic='/image')


@pytest.mark.parametrize(
    'name',
    ['ir_antiuav4_birds_pan', 'ir_antiuav5_sky', 'ir_istd_s1_urban_pan', 'ir_istd_s4_sky_horizon',
     'ir_istd_s6_forest_pan', 'radar_rd_acconeer_a111'])
@pytest.mark.skipif(not DATA_DIR, reason='TBD_DATA_DIR does not name the real recordings')
def test_real_recording_opens(name):
    path = Path(DATA_DIR) / f'{name}.npz'
    with open_recording(path) as recording, np.load(path) as archive:
        np.testing.assert_array_equal(all_frames(recording), archive['frames'])
        assert recording.truth.shape == archive['truth'].shape
        assert recording.stamps_known == ('fps' in archive)


# Images


@given(st.lists(st.integers(0, 2000), unique=True, min_size=1))
def test_numbers_in_names_sort_as_numbers(numbers):
    names = [Path(f'frame{n}.png') for n in numbers]
    assert sorted(names, key=natural_key) == [Path(f'frame{n}.png') for n in sorted(numbers)]


@settings(deadline=None, max_examples=25)
@given(st.sampled_from([('png', 'u1'), ('png', 'u2'), ('bmp', 'u1'), ('tif', 'u1'), ('tif', 'u2'),
                        ('tif', '>u2'), ('tif', 'f4'), ('tif', 'f8')]), st.data())
def test_folder_of_images_gives_back_its_pixels(kind, data):
    image_module = pytest.importorskip('PIL.Image')
    tifffile = pytest.importorskip('tifffile')
    suffix, dtype = kind
    frames = data.draw(hnp.arrays(np.dtype(dtype), (12, 4, 5)))
    with tempfile.TemporaryDirectory() as folder:
        for k, frame in enumerate(frames):
            path = Path(folder) / f'image_{k}.{suffix}'
            if suffix == 'tif':
                tifffile.imwrite(path, frame, byteorder='>' if dtype[0] == '>' else '<')
            else:
                image_module.fromarray(frame).save(path)
        (Path(folder) / 'notes.txt').write_text('not an image')
        with open_recording(folder) as recording:
            assert recording.dtype == np.dtype(dtype).newbyteorder('=')
            assert not recording.stamps_known
            np.testing.assert_array_equal(all_frames(recording), frames)


@pytest.mark.parametrize('mode', ['RGB', 'RGBA', 'P', 'LA', '1', 'CMYK'])
def test_colour_images_become_luminance(tmp_path, mode):
    image_module = pytest.importorskip('PIL.Image')
    image_module.new('L', (5, 4), 255).convert(mode).save(tmp_path / 'a.tif')
    image_module.new('L', (5, 4), 255).convert('RGB').save(tmp_path / 'b.png')
    folder = tmp_path / 'png'
    folder.mkdir()
    if mode == 'CMYK':
        (tmp_path / 'b.png').rename(folder / 'b.png')
    else:
        image_module.new('L', (5, 4), 255).convert(mode).save(folder / 'b.png')
    with open_recording(folder) as recording:
        np.testing.assert_allclose(recording[0], np.full((4, 5), 255), atol=1e-4)


def test_jpeg_is_read(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    image_module.new('L', (16, 8), 77).save(tmp_path / 'a.JPG')
    with open_recording(tmp_path) as recording:
        assert recording.shape == (8, 16) and abs(int(recording[0][0, 0]) - 77) <= 1


def test_bad_folders_are_refused(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    refuse(tmp_path, 'holds neither images')
    for k, size in enumerate([(5, 4), (5, 4), (4, 5)]):
        image_module.new('L', size).save(tmp_path / f'{k}.png')
    refuse(tmp_path, 'frame 2 of .*must be like the first, 4 x 5 of uint8, got 5 x 4')
    (tmp_path / '1.png').write_bytes((tmp_path / '0.png').read_bytes()[:40])
    refuse(tmp_path, '1.png cannot be read')
    (tmp_path / '1.png').write_bytes(b'')
    refuse(tmp_path, '1.png is empty')
    (tmp_path / '1.png').unlink()
    (tmp_path / '1.png').symlink_to(tmp_path / 'nowhere.png')
    refuse(tmp_path, '1.png cannot be read: No such file')


@settings(deadline=None, max_examples=25)
@given(st.sampled_from(['u1', 'u2', '>u2', 'f4', '>f8', 'i2']), st.integers(2, 6), st.booleans(),
       st.data())
def test_tiff_pages_give_back_their_pixels(dtype, n_frames, compressed, data):
    tifffile = pytest.importorskip('tifffile')
    frames = data.draw(hnp.arrays(np.dtype(dtype), (n_frames, 4, 5)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.tiff'
        tifffile.imwrite(path, frames, byteorder='>' if dtype[0] == '>' else '<',
                         photometric='minisblack', compression='zlib' if compressed else None)
        with open_recording(path) as recording:
            np.testing.assert_array_equal(all_frames(recording), frames)
            np.testing.assert_array_equal(recording[0], frames[0])


def test_colour_tiff_pages_become_luminance(tmp_path):
    tifffile = pytest.importorskip('tifffile')
    tifffile.imwrite(tmp_path / 'a.tif', np.full((3, 4, 5, 3), 90, np.uint8), photometric='rgb')
    with open_recording(tmp_path / 'a.tif') as recording:
        np.testing.assert_allclose(all_frames(recording), np.full((3, 4, 5), 90), atol=1e-4)


def test_tiff_with_one_declared_page_is_read_whole(tmp_path):
    tifffile = pytest.importorskip('tifffile')
    frames = RNG.integers(0, 65535, (6, 4, 5)).astype(np.uint16)
    path = tmp_path / 'stack.tif'
    # ImageJ's way for large stacks: one directory, the other frames follow its pixels.
    description = 'ImageJ=1.53\nimages=6\nframes=6\n'
    with tifffile.TiffWriter(path, byteorder='>', imagej=False) as tiff:
        tiff.write(frames[0], description=description, metadata=None)
    with open(path, 'ab') as file:
        file.write(frames[1:].astype('>u2').tobytes())
    with tifffile.TiffFile(path) as tiff:
        if tiff.series[0].shape != frames.shape:
            pytest.skip('this tifffile does not see the stack')
    with open_recording(path) as recording:
        np.testing.assert_array_equal(all_frames(recording), frames)


@pytest.mark.filterwarnings('ignore')
def test_bad_tiffs_are_refused(tmp_path):
    tifffile = pytest.importorskip('tifffile')
    path = tmp_path / 'a.tif'
    tifffile.imwrite(path, np.zeros((4, 5), np.uint8))
    refuse(path, 'single image')
    tifffile.imwrite(path, RNG.integers(0, 9, (5, 40, 50)).astype(np.uint8))
    path.write_bytes(path.read_bytes()[:-3000])
    refuse(path, 'cannot be read')
    path.write_bytes(b'')
    refuse(path, 'not a complete TIFF')


@settings(deadline=None, max_examples=25)
@given(st.sampled_from(['u1', 'u2', 'i2', 'f4', 'f8']), st.booleans(), st.data())
def test_fits_cube_gives_back_its_pixels(dtype, in_extension, data):
    fits = pytest.importorskip('astropy.io.fits')
    frames = data.draw(hnp.arrays(np.dtype(dtype), (3, 4, 5)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.fits'
        units = [fits.PrimaryHDU(), fits.ImageHDU(frames)] if in_extension else [
            fits.PrimaryHDU(frames)]
        fits.HDUList(units).writeto(path)
        with open_recording(path) as recording:
            assert recording.dtype == np.dtype(dtype) and recording[0].dtype.isnative
            np.testing.assert_array_equal(all_frames(recording), frames)
            np.testing.assert_array_equal(recording[0], frames[0])


@pytest.mark.filterwarnings('ignore')
def test_bad_fits_are_refused(tmp_path):
    fits = pytest.importorskip('astropy.io.fits')
    path = tmp_path / 'a.fits'
    fits.PrimaryHDU(np.zeros((4, 5))).writeto(path)
    refuse(path, 'three axes .*found 4x5')
    path.unlink()
    fits.PrimaryHDU(RNG.normal(size=(10, 40, 50))).writeto(path)
    path.write_bytes(path.read_bytes()[:80000])
    refuse(path, 'cannot be read')
    path.write_bytes(b'')
    refuse(path, 'is empty')
    path.write_bytes(b'SIMPLE  =                    T' + b' ' * 50)
    refuse(path, 'fits')
