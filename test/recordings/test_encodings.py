from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
import numpy as np
import pytest

from track_before_detect.errors import DataError
from track_before_detect.recordings.encodings import (
    decode_image,
    ENCODINGS,
    luminance,
    multiarray_stamp,
    multiarray_to_frame,
)

GREY = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2', '16SC1': 'i2', '32FC1': 'f4',
        '64FC1': 'f8'}
COLOUR = {'rgb8': (0, 1, 2), 'bgr8': (2, 1, 0), '8UC3': (2, 1, 0), 'rgba8': (0, 1, 2),
          'bgra8': (2, 1, 0)}
# Which byte of a pixel is its luma.
LUMA = {'yuv422_yuy2': 0, 'yuyv': 0, 'yuv422': 1, 'uyvy': 1}
# The colours of the first two rows.
MOSAICS = {'bayer_rggb': 'RGGB', 'bayer_bggr': 'BGGR', 'bayer_gbrg': 'GBRG', 'bayer_grbg': 'GRBG'}
SHAPES = st.tuples(st.integers(1, 7), st.integers(1, 9))


def padded_rows(pixels, padding):
    """Return the bytes of an image whose rows end with ``padding`` bytes, and the step."""
    rows = [row.tobytes() + b'\xab' * padding for row in pixels]
    return b''.join(rows), len(rows[0])


@given(st.sampled_from(sorted(GREY)), SHAPES, st.integers(0, 5), st.booleans(), st.data())
def test_grey_image_survives_its_bytes(encoding, shape, padding, big, data):
    native = np.dtype(GREY[encoding])
    pixels = data.draw(hnp.arrays(native, shape))
    raw, step = padded_rows(pixels.astype(native.newbyteorder('>' if big else '<')), padding)
    frame = decode_image(raw, encoding, *shape, step, big)
    assert frame.dtype == native and frame.dtype.isnative
    np.testing.assert_array_equal(frame, pixels)


@given(st.sampled_from(sorted(COLOUR)), SHAPES, st.integers(0, 5), st.data())
def test_grey_in_colour_keeps_its_value(encoding, shape, padding, data):
    grey = data.draw(hnp.arrays(np.uint8, shape))
    n_channels = 4 if 'a' in encoding else 3
    pixels = np.repeat(grey[..., None], n_channels, axis=2)
    if n_channels == 4:
        pixels[..., 3] = 17
    raw, step = padded_rows(pixels, padding)
    frame = decode_image(raw, encoding, *shape, step, False)
    assert frame.dtype == np.float32
    np.testing.assert_allclose(frame, grey, atol=1e-4)


@pytest.mark.parametrize('encoding', sorted(COLOUR))
def test_channels_are_weighted_in_their_order(encoding):
    pixels = np.zeros((1, 3, 4 if 'a' in encoding else 3), np.uint8)
    for column, channel in enumerate(COLOUR[encoding]):
        pixels[0, column, channel] = 200
    frame = decode_image(pixels.tobytes(), encoding, 1, 3, pixels[0].nbytes, False)
    np.testing.assert_allclose(frame[0], [59.8, 117.4, 22.8], rtol=1e-6)


@given(st.sampled_from(sorted(LUMA)), SHAPES, st.integers(0, 5), st.data())
def test_the_luma_of_colour_shared_by_pixels_is_read_as_mono8(encoding, shape, padding, data):
    luma = data.draw(hnp.arrays(np.uint8, shape))
    pixels = data.draw(hnp.arrays(np.uint8, (*shape, 2)))
    pixels[..., LUMA[encoding]] = luma
    raw, step = padded_rows(pixels, padding)
    frame = decode_image(raw, encoding, *shape, step, False)
    assert frame.dtype == np.uint8
    np.testing.assert_array_equal(frame, luma)


@pytest.mark.parametrize('encoding', sorted(MOSAICS))
@pytest.mark.parametrize('item', ['u1', '<u2', '>u2'])
def test_a_mosaic_of_filters_does_not_show_and_nothing_is_shifted(encoding, item):
    item = np.dtype(item)
    filters = np.tile(np.reshape(list(MOSAICS[encoding]), (2, 2)), (4, 5))
    colour = {'R': 40, 'G': 100, 'B': 220}
    slope = np.arange(10)
    pixels = (np.vectorize(colour.get)(filters) + slope).astype(item)
    frame = decode_image(pixels.tobytes(), f'{encoding}{8 * item.itemsize}', 8, 10,
                         pixels[0].nbytes, item.str[0] == '>')
    assert frame.dtype == np.float32
    # A quarter red, half green, a quarter blue, where the picture is smooth; mirrored at its ends.
    np.testing.assert_allclose(frame[:, 1:-1], np.tile(115 + slope[1:-1], (8, 1)))
    np.testing.assert_allclose(frame[:, [0, -1]], np.tile([115.5, 123.5], (8, 1)))


def test_last_row_may_lack_its_padding():
    raw = bytes([1, 2, 0, 3, 4])
    np.testing.assert_array_equal(decode_image(raw, 'mono8', 2, 2, 3, False), [[1, 2], [3, 4]])


def test_frame_does_not_share_memory_with_the_message():
    raw = bytearray(4)
    frame = decode_image(raw, 'mono8', 2, 2, 2, False)
    raw[0] = 9
    assert frame[0, 0] == 0


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [((b'abcd', 'nv12', 2, 2, 2, 0), "must be one of .*'nv12'"),
     ((b'abc', 'mono8', 2, 2, 2, 0), 'needs 4 bytes, got 3'),
     ((b'abcd', 'mono16', 1, 2, 3, 0), 'at least 4 bytes, got 3'),
     ((b'', 'mono8', 0, 5, 5, 0), 'at least one pixel')],
    ids=['encoding', 'short', 'step', 'empty'])
def test_bad_image_is_refused_in_one_sentence(arguments, message):
    with pytest.raises(DataError, match=message):
        decode_image(*arguments)


def test_every_encoding_is_listed():
    assert set(ENCODINGS) == set(GREY) | set(COLOUR) | set(LUMA) | {'32FC2'} | {
        encoding.replace('8', '16') for encoding in COLOUR} | {'8UC4', '16UC4'} | {
        f'{mosaic}{bits}' for mosaic in MOSAICS for bits in (8, 16)}


@pytest.mark.parametrize('big', [False, True])
def test_two_channels_are_real_and_imaginary_part(big):
    parts = np.arange(12, dtype='>f4' if big else '<f4').reshape(2, 3, 2)
    padded = b''.join(row.tobytes() + b'pad!' for row in parts)
    frame = decode_image(padded, '32FC2', 2, 3, 28, big)
    assert frame.dtype == np.complex64
    np.testing.assert_array_equal(frame, parts[..., 0] + 1j * parts[..., 1])


def test_luminance_ignores_alpha():
    colour = np.zeros((2, 2, 4), np.uint16)
    colour[..., 3] = 65535
    assert not luminance(colour).any()


@given(SHAPES, st.integers(0, 4), st.integers(0, 4), st.data())
def test_multiarray_honours_offset_and_row_stride(shape, gap, offset, data):
    pixels = data.draw(hnp.arrays(np.float32, shape, elements=st.floats(-9, 9, width=32)))
    rows = np.full((shape[0], shape[1] + gap), np.nan, np.float32)
    rows[:, :shape[1]] = pixels
    items = np.concatenate([np.full(offset, np.nan, np.float32), rows.ravel()])
    frame = multiarray_to_frame(items, shape, (rows.size, rows.shape[1]), offset)
    np.testing.assert_array_equal(frame, pixels)


@pytest.mark.parametrize(
    ('sizes', 'strides'),
    [((2, 3), (6, 3)), ((2, 3), (0, 0)), ((1, 2, 3), (6, 6, 3)), ((2, 3, 1), (6, 3, 1)),
     ((2, 1, 3), (6, 3, 3)), ((1, 2, 3), (0, 0, 0))])
def test_layouts_of_one_frame_agree(sizes, strides):
    frame = multiarray_to_frame(np.arange(6, dtype=np.float32), sizes, strides)
    np.testing.assert_array_equal(frame, np.arange(6).reshape(2, 3))


@pytest.mark.parametrize(('labels', 'expected'), [
    (['rows', 'columns'], None),
    ([], None),
    (['stamp=5.000000007', 'columns'], (5, 7, '')),
    (['rows', 'stamp=2147483647.999999999 frame_id=map/radar'],
     (2147483647, 999999999, 'map/radar')),
    (['stamp=5.000000007 frame_id=left camera'], (5, 7, 'left camera')),
])
def test_a_label_may_stamp_an_array(labels, expected):
    assert multiarray_stamp(labels) == expected


@pytest.mark.parametrize('label', [
    'stamp=5', 'stamp=5.25', 'stamp=-1.000000000', 'stamp=2147483648.000000000',
    'stamp=1.000000000 radar', 'stamp=1.000000000 frame_id=' + 'x' * 256])
def test_a_label_that_is_no_stamp_is_refused(label):
    with pytest.raises(DataError, match='a label with a stamp must be stamp=SECONDS'):
        multiarray_stamp([label])


def test_one_dimension_is_one_row():
    assert multiarray_to_frame(np.arange(5.0), [5], [5]).shape == (1, 5)


@pytest.mark.parametrize(
    ('sizes', 'strides', 'offset', 'message'),
    [((), (), 0, 'rows and columns'), ((2, 3), (6,), 0, '2 sizes and 1 strides'),
     ((0, 3), (0, 3), 0, 'at least 1'), ((2, 3), (6, 1), 0, 'overlaps'),
     ((2, 3), (6, 3), 1, 'needs 7 items, got 6'), ((2, 3), (6, -3), 0, 'negative'),
     ((1, 2, 1, 3, 1), (6, 6, 3, 3, 1), -1, 'negative'), ((2, 3, 2), (12, 6, 2), 0, 'needs 12')],
    ids=['none', 'ragged', 'zero', 'overlap', 'offset', 'negative', 'minus', 'volume'])
def test_bad_layout_is_refused(sizes, strides, offset, message):
    with pytest.raises(DataError, match=message):
        multiarray_to_frame(np.arange(6.0), sizes, strides, offset)


def test_volume_is_not_a_frame():
    with pytest.raises(DataError, match='rows and columns alone'):
        multiarray_to_frame(np.arange(12.0), (2, 3, 2), (12, 6, 2))
