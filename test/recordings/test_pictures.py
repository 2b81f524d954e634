"""Images, TIFF and FITS files as people have them: exact values, axes, stamps, or one sentence."""

import re
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest

from track_before_detect.errors import DataError, MissingExtraError
from track_before_detect.recordings.encodings import luminance
from track_before_detect.recordings.images import read_image
from track_before_detect.recordings.open_recording import open_recording

RNG = np.random.default_rng(7)
FRAMES = RNG.integers(0, 65536, (12, 9, 10)).astype(np.uint16)


def read(path):
    """Return all frames, the stamps (None if made up), and what is remarked beside those."""
    with open_recording(path) as recording:
        frames = np.stack([recording[k] for k in range(len(recording))])
        stamps = recording.stamps if recording.stamps_known else None
        return frames, stamps, [said for said in recording.remarks if 'no stamps' not in said]


def refuse(path, message, error=DataError):
    with pytest.raises(error, match=message) as caught:
        read(path)
    assert '\n' not in str(caught.value)


# PNG


def write_png(path, pixels, colour):
    """Write 16-bit channels last, each row with another one of the five filters."""
    height, width, channels = pixels.shape
    rows = pixels.astype('>u2').reshape(height, -1).view(np.uint8).astype(int)
    step = 2 * channels
    filtered = []
    for y, row in enumerate(rows):
        left = np.concatenate([np.zeros(step, int), row[:-step]])
        up = rows[y - 1] if y else np.zeros_like(row)
        corner = np.concatenate([np.zeros(step, int), up[:-step]])
        nearest = [np.abs(left + up - corner - other) for other in (left, up, corner)]
        paeth = np.choose(np.argmin(nearest, axis=0), (left, up, corner))
        guess = (np.zeros_like(row), left, up, (left + up) // 2, paeth)[y % 5]
        filtered.append(bytes([y % 5]) + ((row - guess) % 256).astype(np.uint8).tobytes())

    def chunk(kind, data):
        body = kind + data
        return struct.pack('>I', len(data)) + body + struct.pack('>I', zlib.crc32(body))

    header = struct.pack('>IIBBBBB', width, height, 16, colour, 0, 0, 0)
    path.write_bytes(b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', header)
                     + chunk(b'IDAT', zlib.compress(b''.join(filtered))) + chunk(b'IEND', b''))


@pytest.mark.parametrize(('channels', 'colour'), [(2, 4), (3, 2), (4, 6)])
def test_sixteen_bit_png_keeps_its_low_bytes(tmp_path, channels, colour):
    pytest.importorskip('PIL')
    pixels = RNG.integers(0, 65536, (11, 9, channels)).astype(np.uint16)
    write_png(tmp_path / 'a.png', pixels, colour)
    expected = pixels[..., 0] if channels == 2 else luminance(pixels)
    frame = read_image(tmp_path / 'a.png')
    assert frame.dtype == expected.dtype
    np.testing.assert_array_equal(frame, expected)


@pytest.mark.parametrize('first', ['L', 'RGB'])
def test_grey_and_colour_files_of_equal_values_are_read_together(tmp_path, first):
    image_module = pytest.importorskip('PIL.Image')
    grey = FRAMES.astype(np.uint8)
    for k, frame in enumerate(grey):
        mode = first if k % 3 == 0 else {'L': 'RGB', 'RGB': 'L'}[first]
        image_module.fromarray(frame).convert(mode).save(tmp_path / f'{k}.png')
    frames, _, _ = read(tmp_path)
    np.testing.assert_allclose(frames, grey, rtol=1e-6)


def test_a_colour_file_among_grey_ones_is_named(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    for k in range(3):
        image_module.new('L', (5, 4), 90).save(tmp_path / f'{k}.png')
    image_module.new('RGB', (5, 4), (90, 0, 3)).save(tmp_path / '2.png')
    refuse(tmp_path, 'frame 2 .*2.png, must be like the first, 4 x 5 of uint8, got .*float32')
    image_module.fromarray(np.zeros((4, 5), np.uint16)).save(tmp_path / '1.png')
    refuse(tmp_path, 'frame 1 .*1.png, must be like the first')


def test_masks_beside_frames_are_left_out_and_said(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    for k in range(12):
        image_module.new('L', (5, 4), k).save(tmp_path / f'{k}.png')
        image_module.new('L', (5, 4), 255).save(tmp_path / f'{k}_mask.png')
    frames, _, remarks = read(tmp_path)
    np.testing.assert_array_equal(frames[:, 0, 0], np.arange(12))
    [remark] = remarks
    assert '12 images' in remark and '0_mask.png' in remark


def test_masks_alone_are_frames(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    for k in range(3):
        image_module.new('L', (5, 4), k).save(tmp_path / f'{k}_mask.png')
    frames, _, remarks = read(tmp_path)
    assert len(frames) == 3 and not remarks


# TIFF


@pytest.mark.parametrize('name', ['a.tif', 'a.ome.tif'])
@pytest.mark.parametrize(('axes', 'found'), [('TCYX', '6 frames x 2 channels'),
                                             ('TZYX', '6 frames x 2 slices')])
def test_channels_and_slices_beside_frames_are_refused(tmp_path, name, axes, found):
    tifffile = pytest.importorskip('tifffile')
    tifffile.imwrite(tmp_path / name, FRAMES.reshape(6, 2, 9, 10), imagej=name == 'a.tif',
                     metadata={'axes': axes}, photometric='minisblack')
    refuse(tmp_path / name, f'got {found} .axes {axes}.; save one')


def test_stack_of_several_unnamed_axes_is_refused(tmp_path):
    tifffile = pytest.importorskip('tifffile')
    tifffile.imwrite(tmp_path / 'a.tif', FRAMES.reshape(6, 2, 9, 10), photometric='minisblack')
    refuse(tmp_path / 'a.tif', 'got 6 pages x 2 pages')
    tifffile.imwrite(tmp_path / 'a.tif', FRAMES[:, None], photometric='minisblack')
    np.testing.assert_array_equal(read(tmp_path / 'a.tif')[0], FRAMES)


@pytest.mark.parametrize('axes', ['ZYX', 'CYX'])
def test_slices_or_channels_alone_are_frames_and_said(tmp_path, axes):
    tifffile = pytest.importorskip('tifffile')
    tifffile.imwrite(tmp_path / 'a.tif', FRAMES, imagej=True, metadata={'axes': axes})
    frames, stamps, [remark] = read(tmp_path / 'a.tif')
    np.testing.assert_array_equal(frames, FRAMES)
    assert stamps is None and 'read as frames' in remark


@pytest.mark.parametrize(('name', 'metadata', 'interval'), [
    ('a.tif', {'finterval': 0.05}, 0.05),
    ('a.tif', {'finterval': 50, 'tunit': 'ms'}, 0.05),
    ('a.tif', {'finterval': 5, 'tunit': 'h'}, 18000.0),
    ('a.tif', {'finterval': 0.0}, None),
    ('a.tif', {'finterval': 3, 'tunit': 'moons'}, None),
    ('a.ome.tif', {'TimeIncrement': 0.05}, 0.05),
    ('a.ome.tif', {'TimeIncrement': 50, 'TimeIncrementUnit': 'ms'}, 0.05),
    ('a.ome.tif', {'TimeIncrement': 300, 'TimeIncrementUnit': 'min'}, 18000.0),
    ('a.ome.tif', {}, None)])
def test_frame_interval_of_the_file_is_used(tmp_path, name, metadata, interval):
    tifffile = pytest.importorskip('tifffile')
    tifffile.imwrite(tmp_path / name, FRAMES, imagej=name == 'a.tif',
                     metadata={'axes': 'TYX', **metadata}, photometric='minisblack')
    frames, stamps, remarks = read(tmp_path / name)
    np.testing.assert_array_equal(frames, FRAMES)
    assert not remarks
    if interval is None:
        assert stamps is None
    else:
        np.testing.assert_allclose(stamps, interval * np.arange(12))


def test_stamps_of_single_planes_are_used(tmp_path):
    tifffile = pytest.importorskip('tifffile')
    times = np.cumsum(RNG.uniform(1, 9, 12)).round(3)
    tifffile.imwrite(tmp_path / 'a.ome.tif', FRAMES, photometric='minisblack', metadata={
        'axes': 'TYX', 'TimeIncrement': 4.0,
        'Plane': {'DeltaT': times.tolist(), 'TheT': list(range(12))}})
    np.testing.assert_allclose(read(tmp_path / 'a.ome.tif')[1], times)


@pytest.mark.parametrize('dtype', ['u1', 'u2', 'f4'])
def test_tiff_that_needs_another_decoder_is_read_by_pillow(tmp_path, dtype):
    image_module = pytest.importorskip('PIL.Image')
    pytest.importorskip('tifffile')
    frames = FRAMES.astype(dtype)
    first, *others = [image_module.fromarray(frame) for frame in frames]
    path = tmp_path / 'a.tif'
    first.save(path, save_all=True, append_images=others, compression='tiff_lzw')
    np.testing.assert_array_equal(read(path)[0], frames)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[5], frames[5])
        np.testing.assert_array_equal(recording[2], frames[2])
    np.testing.assert_array_equal(read_image(path), frames[0])


def test_tiff_that_nothing_here_decodes_names_the_package(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    tifffile = pytest.importorskip('tifffile')
    path = tmp_path / 'a.tif'
    image_module.new('L', (5, 4), 9).save(path, compression='tiff_lzw')
    with tifffile.TiffFile(path) as tiff:
        offset = tiff.pages[0].tags['PhotometricInterpretation'].valueoffset
    data = bytearray(path.read_bytes())
    # White is zero: Pillow would turn the values round.
    data[offset:offset + 2] = b'\0\0'
    path.write_bytes(bytes(data))
    try:
        import imagecodecs  # noqa: F401
    except ImportError:
        refuse(tmp_path, 'a.tif .LZW of uint8. needs imagecodecs: pip', MissingExtraError)


def test_colours_of_a_palette_are_read(tmp_path):
    image_module = pytest.importorskip('PIL.Image')
    pytest.importorskip('tifffile')
    image = image_module.fromarray(np.arange(20, dtype=np.uint8).reshape(4, 5), 'P')
    image.putpalette(bytes(range(255, -1, -1)) * 3)
    image.save(tmp_path / 'a.tif')
    np.testing.assert_allclose(read_image(tmp_path / 'a.tif'),
                               luminance(np.asarray(image.convert('RGB'))), atol=1e-3)


# FITS


@pytest.mark.parametrize('dtype', ['u1', 'i2', 'u2', 'i4', 'u4'])
def test_blank_pixels_are_not_numbers(tmp_path, dtype):
    fits = pytest.importorskip('astropy.io.fits')
    frames = RNG.integers(0, 100, (12, 9, 10)).astype(dtype)
    frames[3, 4, 5] = 111
    unit = fits.PrimaryHDU(frames)
    unit.header['BLANK'] = 111 - unit.header.get('BZERO', 0)
    unit.writeto(tmp_path / 'a.fits')
    read_back, _, _ = read(tmp_path / 'a.fits')
    expected = frames.astype(float)
    expected[3, 4, 5] = np.nan
    np.testing.assert_array_equal(read_back, expected)


def date(k):
    return f'2026-03-01T23:59:{59 * (k < 6):02d}.{50 * k:03d}' if k < 6 else (
        f'2026-03-02T00:00:00.{50 * k:03d}')


def seconds(k):
    return np.datetime64(date(k), 'ns').astype(np.int64) * 1e-9


@pytest.mark.parametrize('kind', ['.gz', '.fz', 'degenerate', 'one axis too many'])
def test_cubes_are_read_however_they_are_packed(tmp_path, kind):
    fits = pytest.importorskip('astropy.io.fits')
    path = tmp_path / f'a.fits{kind if kind[0] == "." else ""}'
    shape = {'degenerate': (1, 12, 9, 10), 'one axis too many': (12, 1, 9, 10)}.get(
        kind, (12, 9, 10))
    unit = fits.CompImageHDU if kind == '.fz' else fits.PrimaryHDU
    unit(FRAMES.reshape(shape)).writeto(path)
    frames, stamps, _ = read(path)
    np.testing.assert_array_equal(frames, FRAMES)
    assert stamps is None
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[7], FRAMES[7])
        np.testing.assert_array_equal(recording[2], FRAMES[2])


@pytest.mark.parametrize('with_errors', [False, True])
def test_an_extension_for_each_frame_is_read(tmp_path, with_errors):
    fits = pytest.importorskip('astropy.io.fits')
    units = [fits.PrimaryHDU()]
    for k, frame in enumerate(FRAMES):
        units.append(fits.ImageHDU(frame, name='SCI' if with_errors else None, ver=k + 1))
        units[-1].header['DATE-OBS'] = date(k)
        if with_errors:
            units.append(fits.ImageHDU(np.ones((9, 10), np.float32), name='ERR', ver=k + 1))
    fits.HDUList(units).writeto(tmp_path / 'a.fits')
    frames, stamps, _ = read(tmp_path / 'a.fits')
    np.testing.assert_array_equal(frames, FRAMES)
    np.testing.assert_allclose(stamps, [seconds(k) for k in range(12)], rtol=0, atol=1e-6)


def write_series(folder, headers, suffix='.fits', order=None):
    """Write a file for each frame, named in ``order``."""
    fits = pytest.importorskip('astropy.io.fits')
    for k, (frame, header) in enumerate(zip(FRAMES, headers, strict=False)):
        name = k if order is None else order[k]
        unit = (fits.CompImageHDU if suffix == '.fits.fz' else fits.PrimaryHDU)(frame)
        unit.header.update(header)
        unit.writeto(folder / f'{name}{suffix}')


@pytest.mark.parametrize('suffix', ['.fits', '.FIT', '.fits.gz', '.fits.fz'])
def test_a_file_for_each_frame_has_the_stamps_of_its_header(tmp_path, suffix):
    write_series(tmp_path, [{'DATE-OBS': date(k)} for k in range(12)], suffix)
    frames, stamps, _ = read(tmp_path)
    np.testing.assert_array_equal(frames, FRAMES)
    np.testing.assert_allclose(stamps, [seconds(k) for k in range(12)], rtol=0, atol=1e-6)


def test_files_are_in_the_order_of_their_stamps(tmp_path):
    write_series(tmp_path, [{'DATE-OBS': date(k)} for k in range(12)], order=RNG.permutation(12))
    np.testing.assert_array_equal(read(tmp_path)[0], FRAMES)


@pytest.mark.parametrize(('headers', 'expected'), [
    ([{'DATE-OBS': '2026-03-01', 'TIME-OBS': f'10:00:{k:02d}'} for k in range(12)], 1.0),
    ([{'MJD-OBS': 61000 + k / 86400} for k in range(12)], 1.0),
    ([{'DATE-OBS': f'2026-03-{k + 1:02d}T22:00:00'} for k in range(12)], 86400.0),
    ([{'DATE-OBS': '2026-03-01'}] * 12, None),
    ([{'DATE-OBS': '01/03/98'}] * 12, None),
    ([{'DATE-OBS': date(0)}] + [{}] * 11, None)])
def test_headers_that_tell_the_time_in_other_ways(tmp_path, headers, expected):
    write_series(tmp_path, headers)
    frames, stamps, remarks = read(tmp_path)
    np.testing.assert_array_equal(frames, FRAMES)
    assert not remarks
    if expected is None:
        assert stamps is None
    else:
        np.testing.assert_allclose(np.diff(stamps), expected, atol=1e-5)


@pytest.mark.filterwarnings('ignore')
def test_bad_series_are_refused_with_the_name_of_the_file(tmp_path):
    fits = pytest.importorskip('astropy.io.fits')
    write_series(tmp_path, [{}] * 3)
    fits.PrimaryHDU(FRAMES).writeto(tmp_path / '1.fits', overwrite=True)
    refuse(tmp_path, '1.fits must hold one frame like each file of a folder, got 12')
    fits.PrimaryHDU(FRAMES[0].T).writeto(tmp_path / '1.fits', overwrite=True)
    refuse(tmp_path, '1.fits, must be like the first, 9 x 10 of uint16, got 10 x 9')
    (tmp_path / '1.fits').write_bytes(b'')
    refuse(tmp_path, '1.fits is empty')
    (tmp_path / '1.fits').write_bytes(b'nothing')
    refuse(tmp_path, '1.fits is not a FITS file')


def test_cut_packed_fits_is_refused(tmp_path):
    fits = pytest.importorskip('astropy.io.fits')
    path = tmp_path / 'a.fits.gz'
    fits.PrimaryHDU(RNG.normal(size=(12, 40, 50))).writeto(path)
    data = path.read_bytes()
    for length in (20, len(data) // 2):
        path.write_bytes(data[:length])
        refuse(path, 'a.fits.gz')


def test_cube_of_two_long_axes_is_refused(tmp_path):
    fits = pytest.importorskip('astropy.io.fits')
    fits.PrimaryHDU(FRAMES.reshape(6, 2, 9, 10)).writeto(tmp_path / 'a.fits')
    refuse(tmp_path / 'a.fits', 'three axes .*found 6x2x9x10')


OPEN_ALL = """
import sys
from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import open_recording
for path in sys.argv[1:]:
    try:
        with open_recording(path) as recording:
            print(recording.remarks[-1], recording[0].sum())
    except DataError as error:
        print(error)
"""


def test_what_a_library_says_of_a_file_is_one_sentence_of_ours(tmp_path):
    tifffile = pytest.importorskip('tifffile')
    fits = pytest.importorskip('astropy.io.fits')
    frames = np.ones((9, 20, 30), np.float32)
    odd, short, cut, header = (tmp_path / name for name in (
        'odd.tif', 'short.tif', 'cut.fits', 'header.fits'))
    tifffile.imwrite(odd, frames, photometric='minisblack', software='somebody')
    data = bytearray(odd.read_bytes())
    with tifffile.TiffFile(odd) as file:
        place = file.pages[0].tags['Software'].offset + 2
    data[place:place + 2] = (99).to_bytes(2, 'little')
    odd.write_bytes(data)
    tifffile.imwrite(short, frames, photometric='minisblack', metadata=None, contiguous=False)
    short.write_bytes(short.read_bytes()[:-12_000])
    fits.writeto(cut, frames)
    data = cut.read_bytes()
    cut.write_bytes(data[:-10_000])
    header.write_bytes(data.replace(b'EXTEND  =                    T',
                                    b'EXTEND  =                Q odd'))
    # In a process of its own, for the tests make errors of what Python warns of.
    done = subprocess.run([sys.executable, '-c', OPEN_ALL, odd, cut, short, header],
                          capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    for line, path, words in zip(lines, (odd, cut, short, header), (
            'is damaged or unusual: .*invalid data type 99.* 600.0$',
            'is damaged or unusual: File may have been truncated.* 600.0$',
            'holds a single image; .*invalid page offset', 'is not a FITS file.*Unparsable card'),
            strict=True):
        assert re.search(f'{path.name} {words}', line), line
    assert done.stderr == ''
