import io
import time

import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402
from hypothesis import given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
import numpy as np  # noqa: E402
import PIL.Image  # noqa: E402
from rclpy.clock import Clock  # noqa: E402
from rclpy.time import Time as ClockTime  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image  # noqa: E402
from std_msgs.msg import Float32MultiArray, Header, MultiArrayDimension  # noqa: E402

from track_before_detect.errors import DataError  # noqa: E402
from track_before_detect.recordings.encodings import ENCODINGS  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.intake.frame_reader import FrameReader  # noqa: E402

FRAME = np.arange(12, dtype=np.float32).reshape(3, 4)
HEADER = Header(stamp=Time(sec=100, nanosec=5), frame_id='camera')


@pytest.fixture
def warned():
    return {}


def reader(warned, source='header', shape=(0, 0), clock=None):
    return FrameReader(source, shape, clock or Clock(), warned.__setitem__)


def picture(pixels, kind='PNG', **options):
    file = io.BytesIO()
    PIL.Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def compressed(data, description='png'):
    message = CompressedImage(header=HEADER, format=description)
    message.data = data
    return message


def test_a_frame_has_the_stamp_and_frame_id_of_its_message(warned):
    frame = reader(warned).image(conversions.image_from_frame(FRAME, HEADER))
    np.testing.assert_array_equal(frame.pixels, FRAME)
    assert frame.header == HEADER and frame.stamp_s == pytest.approx(100, abs=1e-8)
    assert not warned


@pytest.mark.parametrize(('earlier', 'is_taken'), [
    ((), True), ((40,), True), ((0, 40), True), ((0,), False), ((1_700_000_000,), False),
    ((0, 0), False), ((40, 0), False), ((1_700_000_000, 0), False)])
def test_a_stamp_of_zero_is_none_but_where_a_recording_begins_or_loops(warned, earlier, is_taken):
    frames = reader(warned)

    def image(sec):
        return conversions.image_from_frame(FRAME, Header(stamp=Time(sec=sec)))

    for sec in earlier:
        try:
            frames.image(image(sec))
        except DataError:
            assert sec == 0
    if is_taken:
        assert frames.image(image(0)).stamp_s == 0.0
    else:
        with pytest.raises(DataError, match='is 0, which is taken for none: .*stamp_source=arr'):
            frames.image(image(0))
    assert reader(warned, 'arrival').image(image(0)).stamp_s == pytest.approx(time.time(), abs=1)


@pytest.mark.parametrize(('stamp', 'sentence'), [
    (Time(sec=1, nanosec=10**9), 'nanosec of header.stamp must be below 1e9, got 1000000000'),
    (Time(sec=1, nanosec=2**32 - 1), 'must be below 1e9, got 4294967295'),
])
def test_a_stamp_that_is_none_is_refused_where_the_header_counts(warned, stamp, sentence):
    message = conversions.image_from_frame(FRAME, Header(stamp=stamp, frame_id='camera'))
    with pytest.raises(DataError, match=sentence):
        reader(warned).image(message)
    frame = reader(warned, 'arrival').image(message)
    assert frame.header.frame_id == 'camera'
    assert frame.stamp_s == pytest.approx(time.time(), abs=1.0)


def test_a_clock_that_stands_still_stamps_one_frame_and_a_steady_one_all(warned):
    class Still:
        def now(self):
            return ClockTime(seconds=7)

    clock = Still()
    message = conversions.multiarray_from_frame(FRAME)
    plain = reader(warned, clock=clock)
    assert plain.multiarray(message).stamp_s == 7
    with pytest.raises(DataError, match='stands still at 7 s.*stamp_source=steady'):
        plain.multiarray(message)
    steady = reader(warned, 'steady', clock=clock)
    stamps = [steady.multiarray(message).stamp_s for _ in range(3)]
    assert stamps == sorted(set(stamps))
    assert stamps[0] == pytest.approx(time.time(), abs=1.0)


def test_an_array_may_have_its_stamp_and_frame_id_in_a_label(warned):
    message = conversions.multiarray_from_frame(FRAME, HEADER)
    frame = reader(warned).multiarray(message)
    assert frame.header == HEADER
    np.testing.assert_array_equal(frame.pixels, FRAME)
    arrived = reader(warned, 'arrival').multiarray(message)
    assert arrived.stamp_s == pytest.approx(time.time(), abs=1.0)
    assert arrived.header.frame_id == 'camera'
    message.layout.dim[0].label = 'stamp=now'
    with pytest.raises(DataError, match="nine digits after the point, got 'stamp=now'"):
        reader(warned).multiarray(message)


def test_an_array_without_layout_has_the_size_that_was_told(warned):
    message = Float32MultiArray(data=FRAME.ravel().tolist())
    np.testing.assert_array_equal(reader(warned, shape=(3, 4)).multiarray(message).pixels, FRAME)
    for shape, sentence in (((0, 0), 'must name the size'), ((4, 4), 'needs 16 items, got 12')):
        with pytest.raises(DataError, match=sentence):
            reader(warned, shape=shape).multiarray(message)


def test_data_beyond_the_frame_is_used_for_nothing_and_said(warned):
    message = conversions.image_from_frame(FRAME, HEADER)
    message.data = bytes(message.data) + b'12345'
    np.testing.assert_array_equal(reader(warned).image(message).pixels, FRAME)
    assert 'holds 5 bytes more than its size says' in warned.pop('rest')
    array = conversions.multiarray_from_frame(FRAME)
    array.data.extend([1.0, 2.0])
    np.testing.assert_array_equal(reader(warned).multiarray(array).pixels, FRAME)
    assert 'holds 2 items more than its size says' in warned.pop('rest')


def test_padded_rows_are_no_data_beyond_the_frame(warned):
    padded = np.pad(FRAME, ((0, 0), (0, 2)))
    image = conversions.image_from_frame(padded, HEADER)
    image.width = 4
    array = Float32MultiArray(data=np.append(9.0, padded).tolist())
    array.layout.data_offset = 1
    array.layout.dim = [MultiArrayDimension(size=3, stride=18),
                        MultiArrayDimension(size=4, stride=6)]
    for frame in (reader(warned).image(image), reader(warned).multiarray(array)):
        np.testing.assert_array_equal(frame.pixels, FRAME)
    assert not warned


def test_pictures_of_8_and_16_bits_are_unpacked(warned):
    deep = (1000 * FRAME).astype(np.uint16)
    frame = reader(warned).compressed_image(compressed(picture(deep), 'mono16; png compressed '))
    np.testing.assert_array_equal(frame.pixels, deep)
    assert frame.header == HEADER
    flat = np.full((16, 16), 77, np.uint8)
    frame = reader(warned).compressed_image(compressed(picture(flat, 'JPEG'), 'jpeg'))
    np.testing.assert_array_equal(frame.pixels, flat)
    filters = np.tile(np.array([[40, 80], [80, 120]], np.uint8), (3, 3))
    frame = reader(warned).compressed_image(
        compressed(picture(filters), 'bayer_rggb8; png compressed '))
    np.testing.assert_allclose(frame.pixels, 80)


@pytest.mark.parametrize(('data', 'sentence'), [
    (b'', 'its png cannot be read: it is no PNG or JPEG'),
    (b'nonsense', 'it is no PNG or JPEG'),
    (picture(np.zeros((8, 8), np.uint8))[:-30], 'cannot be read'),
    (picture(np.zeros((4, 4), np.uint8), 'TIFF'), 'it is no PNG or JPEG'),
    (picture(np.zeros((1, 2**26 + 1), bool)), 'at most 67108864 pixels, got 1 x 67108865'),
], ids=['empty', 'nonsense', 'cut', 'foreign', 'huge'])
def test_what_is_no_picture_or_a_huge_one_is_refused_before_it_is_unpacked(
        warned, data, sentence):
    with pytest.raises(DataError, match=sentence):
        reader(warned).compressed_image(compressed(data))


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize('encoding', ['rgb16', 'bgr16', 'rgba16', 'bgra16', 'mono16'])
def test_colour_of_16_bits_is_luminance_in_either_byte_order(warned, encoding, big):
    colours = {'r': 50_000, 'g': 300, 'b': 20_000, 'a': 9}
    names = encoding[:-2] if encoding != 'mono16' else 'g'
    pixels = np.tile(np.array([colours[name] for name in names], '>u2' if big else '<u2'),
                     (3, 4, 1))
    image = Image(header=HEADER, height=3, width=4, encoding=encoding, is_bigendian=int(big),
                  step=8 * len(names))
    image.data = pixels.tobytes()
    wanted = 300 if names == 'g' else 0.299 * 50_000 + 0.587 * 300 + 0.114 * 20_000
    np.testing.assert_allclose(reader(warned).image(image).pixels, wanted, rtol=1e-6)


@settings(deadline=None, max_examples=300)
@given(st.sampled_from([*ENCODINGS, '', 'nv12', 'mono8 ']), st.integers(0, 6), st.integers(0, 6),
       st.integers(0, 40) | st.just(2**32 - 1), st.integers(0, 255), st.binary(max_size=300),
       st.integers(0, 2**32 - 1))
def test_any_image_is_a_frame_or_refused_in_words(encoding, height, width, step, big, data, ns):
    message = Image(header=Header(stamp=Time(sec=1, nanosec=ns)), encoding=encoding, step=step,
                    height=height, width=width, is_bigendian=big)
    message.data = data
    try:
        frame = reader({}).image(message)
    except DataError:
        return
    assert frame.pixels.shape == (height, width)


@settings(deadline=None, max_examples=300)
@given(st.lists(st.tuples(*2 * [st.integers(0, 9) | st.just(2**32 - 1)]), max_size=4),
       st.integers(0, 4) | st.just(2**32 - 1), st.integers(0, 40))
def test_any_array_is_a_frame_or_refused_in_words(dimensions, offset, n_items):
    message = Float32MultiArray(data=[1.0] * n_items)
    message.layout.data_offset = offset
    message.layout.dim = [
        MultiArrayDimension(size=size, stride=stride) for size, stride in dimensions]
    try:
        frame = reader({}, shape=(2, 3)).multiarray(message)
    except DataError:
        return
    assert frame.pixels.ndim == 2 and frame.pixels.size <= n_items


PICTURES = [picture(np.arange(64, dtype=np.uint8).reshape(8, 8), kind) for kind in ('PNG', 'JPEG')]


@settings(deadline=None, max_examples=300)
@given(st.sampled_from(PICTURES), st.data())
def test_any_picture_is_a_frame_or_refused_in_words(sound, data):
    spoilt = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 4))):
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    try:
        frame = reader({}).compressed_image(compressed(bytes(spoilt)))
    except DataError:
        return
    assert frame.pixels.ndim == 2
