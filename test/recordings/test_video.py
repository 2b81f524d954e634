"""Videos made here with PyAV come back as they were, in any order of access."""

from fractions import Fraction
import subprocess
import sys
import textwrap
from unittest import mock

import av
from hypothesis import example, given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.errors import DataError
from track_before_detect.recordings import recording as recording_module
from track_before_detect.recordings.encodings import luminance
from track_before_detect.recordings.open_recording import open_recording

MILLISECONDS = Fraction(1, 1000)
N_FRAMES, HEIGHT, WIDTH = 23, 18, 34


def noise(n_frames=N_FRAMES, levels=256, shape=(HEIGHT, WIDTH)):
    """Return frames that no codec finds easy."""
    kind = np.uint8 if levels <= 256 else np.uint16
    return np.random.default_rng(5).integers(0, levels, (n_frames, *shape)).astype(kind)


def write(path, codec, pixel_format, frames, stamps_ms=None, *, made_of='gray', height=None,
          b_frames=0, key_every=5, **options):
    """Encode frames at times in milliseconds, by default 40 ms apart."""
    stamps_ms = 40 * np.arange(len(frames)) if stamps_ms is None else stamps_ms
    with av.open(str(path), 'w') as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.height, stream.width = height or frames.shape[1], frames.shape[2]
        stream.pix_fmt = pixel_format
        stream.codec_context.time_base = stream.time_base = MILLISECONDS
        stream.codec_context.gop_size = key_every
        stream.codec_context.max_b_frames = b_frames
        for pixels, stamp in zip(frames, stamps_ms, strict=True):
            picture = av.VideoFrame.from_ndarray(pixels, format=made_of)
            if made_of != pixel_format:
                picture = picture.reformat(format=pixel_format)
            picture.pts, picture.time_base = int(stamp), MILLISECONDS
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def all_frames(recording):
    return np.stack([recording[k] for k in range(len(recording))])


def with_luma(frames, value=128):
    """Return grey frames as planes of YUV 4:2:0 without colour."""
    n_frames, height, width = frames.shape
    chroma = np.full((n_frames, height // 2, width), value, frames.dtype)
    return np.concatenate([frames, chroma], axis=1)


LOSSLESS = {
    'ffv1 grey, mkv': ('a.mkv', 'ffv1', 'gray', 256, {}),
    'ffv1 grey, avi': ('a.avi', 'ffv1', 'gray', 256, {}),
    'ffv1 10 bits, mkv': ('a.mkv', 'ffv1', 'gray10le', 1024, {}),
    'ffv1 12 bits, mkv': ('a.mkv', 'ffv1', 'gray12le', 4096, {}),
    'ffv1 16 bits, mkv': ('a.mkv', 'ffv1', 'gray16le', 65536, {}),
    'png 16 bits big-endian, mov': ('a.mov', 'png', 'gray16be', 65536, {}),
    'raw grey, avi': ('a.avi', 'rawvideo', 'gray', 256, {}),
    'h264 lossless, mp4': ('a.mp4', 'libx264', 'gray', 256, {'qp': '0'}),
    'h264 lossless with pictures out of order, mp4': (
        'a.mp4', 'libx264', 'gray', 256, {'qp': '0', 'b_frames': 3, 'key_every': 7}),
    'h264 lossless with pictures out of order, mkv': (
        'a.mkv', 'libx264', 'gray', 256, {'qp': '0', 'b_frames': 3, 'key_every': 7}),
    'h264 lossless with open groups, mov': (
        'a.mov', 'libx264', 'gray', 256,
        {'qp': '0', 'b_frames': 3, 'key_every': 7, 'x264-params': 'open-gop=1'}),
    'h264 lossless with one key frame, mp4': (
        'a.mp4', 'libx264', 'gray', 256, {'qp': '0', 'b_frames': 2, 'key_every': 500}),
    'h264 lossless with pictures out of order, avi': (
        'a.avi', 'libx264', 'gray', 256, {'qp': '0', 'b_frames': 2, 'key_every': 7}),
}


@pytest.fixture(scope='module')
def lossless(tmp_path_factory):
    """Return what makes a video of LOSSLESS, once."""
    made = {}

    def get(kind):
        if kind not in made:
            name, codec, pixel_format, levels, options = LOSSLESS[kind]
            if codec not in av.codecs_available:
                pytest.skip(f'PyAV encodes no {codec} here')
            frames = noise(levels=levels)
            path = tmp_path_factory.mktemp('video') / name
            made[kind] = write(path, codec, pixel_format, frames, made_of=pixel_format,
                               **options), frames
        return made[kind]

    return get


@pytest.mark.parametrize('kind', LOSSLESS)
def test_frames_of_a_lossless_video_come_back_bit_by_bit(lossless, kind):
    path, frames = lossless(kind)
    with open_recording(path) as recording:
        assert (len(recording), recording.shape) == (len(frames), frames.shape[1:])
        np.testing.assert_array_equal(all_frames(recording), frames)
        assert recording.dtype == frames.dtype
        assert recording.stamps_known
        # To the units of the container, and from where its clock began.
        np.testing.assert_allclose(np.diff(recording.stamps), 0.04, atol=2e-4)


@pytest.mark.parametrize('kind', LOSSLESS)
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.lists(st.integers(0, N_FRAMES - 1), min_size=1, max_size=15))
def test_any_order_of_access(lossless, kind, order):
    path, frames = lossless(kind)
    # Nearly every access goes to the decoder: only two frames are kept.
    with mock.patch.object(recording_module, 'CACHE_BYTES', 0):
        with open_recording(path) as recording:
            for k in order:
                np.testing.assert_array_equal(recording[k], frames[k])


@pytest.mark.parametrize('name', ['a.mkv', 'a.mp4', 'a.mov'])
@settings(max_examples=10)
@given(steps=st.lists(st.integers(1, 5000), min_size=1, max_size=12))
@example(steps=[1, 1, 85, 1, 1, 1, 41, 1, 1])
def test_stamps_are_the_presentation_times_of_a_variable_rate(name, steps, tmp_path_factory):
    stamps_ms = np.cumsum([0, *steps])
    path = write(tmp_path_factory.mktemp('rate') / name, 'ffv1' if name == 'a.mkv' else 'libx264',
                 'gray', noise(len(stamps_ms)), stamps_ms, made_of='gray', b_frames=2)
    with av.open(str(path)) as container:
        n_shown = sum(1 for _ in container.decode(video=0))
    # Writers of MP4 may make an edit list that hides the last frame.
    assert n_shown >= len(stamps_ms) - 1
    with open_recording(path) as recording:
        np.testing.assert_allclose(recording.stamps, stamps_ms[:n_shown] / 1000, atol=1e-9)


def test_the_clock_of_a_video_may_begin_late(tmp_path):
    frames = noise(4)
    path = write(tmp_path / 'a.mkv', 'ffv1', 'gray', frames, [5000, 5040, 5080, 5200])
    with open_recording(path) as recording:
        np.testing.assert_allclose(recording.stamps, [5, 5.04, 5.08, 5.2])


def test_avi_frames_lie_on_the_grid_of_its_rate_where_some_are_missing(tmp_path):
    frames = noise(5)
    path = write(tmp_path / 'a.avi', 'ffv1', 'gray', frames, [0, 40, 80, 200, 240])
    with open_recording(path) as recording:
        np.testing.assert_allclose(recording.stamps, [0, 0.04, 0.08, 0.2, 0.24])
        np.testing.assert_array_equal(all_frames(recording), frames)


def test_luma_is_read_as_it_is_stored(tmp_path):
    # 16 and 235 are black and white of video; nothing is stretched to 0 and 255, nothing cut.
    frames = noise()
    path = write(tmp_path / 'a.mkv', 'ffv1', 'yuv420p', with_luma(frames), made_of='yuv420p',
                 height=HEIGHT)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(all_frames(recording), frames)


def test_luma_of_10_bits(tmp_path):
    frames = noise(levels=1024)
    path = write(tmp_path / 'a.mkv', 'ffv1', 'yuv420p10le', with_luma(frames, 512),
                 made_of='yuv420p10le', height=HEIGHT)
    with open_recording(path) as recording:
        assert recording.dtype == np.uint16
        np.testing.assert_array_equal(all_frames(recording), frames)


def test_luma_that_is_packed_beside_the_colours(tmp_path):
    frames = noise()
    packed = np.stack([frames, np.full_like(frames, 128)], axis=3)
    path = write(tmp_path / 'a.mov', 'rawvideo', 'yuyv422', packed, made_of='yuyv422')
    with open_recording(path) as recording:
        np.testing.assert_array_equal(all_frames(recording), frames)


@pytest.mark.parametrize('name, codec, pixel_format', [
    ('a.mov', 'qtrle', 'rgb24'), ('a.mkv', 'ffv1', 'bgr0'), ('a.avi', 'rawvideo', 'bgr24'),
    ('a.mkv', 'libx264rgb', 'rgb24'), ('a.mov', 'png', 'rgba')])
def test_colour_becomes_luminance(tmp_path, name, codec, pixel_format):
    colours = np.random.default_rng(6).integers(0, 256, (6, HEIGHT, WIDTH, 3)).astype(np.uint8)
    path = write(tmp_path / name, codec, pixel_format, colours, made_of='rgb24', qp='0')
    with open_recording(path) as recording:
        expected = np.stack([luminance(frame) for frame in colours])
        np.testing.assert_array_equal(all_frames(recording), expected)


def test_deep_colour_becomes_luminance_of_16_bits(tmp_path):
    colours = np.random.default_rng(6).integers(0, 65536, (6, HEIGHT, WIDTH, 3)).astype(np.uint16)
    path = write(tmp_path / 'a.mov', 'png', 'rgb48be', colours, made_of='rgb48be')
    with open_recording(path) as recording:
        expected = np.stack([luminance(frame) for frame in colours])
        np.testing.assert_array_equal(all_frames(recording), expected)


@pytest.mark.parametrize('name, codec, pixel_format, levels', [
    ('a.mp4', 'mpeg4', 'yuv420p', 256), ('a.avi', 'mpeg4', 'yuv420p', 256),
    ('a.avi', 'mjpeg', 'yuvj420p', 256), ('a.mkv', 'libx265', 'gray12le', 4096),
    ('a.mkv', 'libvpx', 'yuv420p', 256), ('a.mp4', 'libvpx-vp9', 'yuv420p', 256)])
def test_a_lossy_video_is_what_its_decoder_makes_of_it(tmp_path, name, codec, pixel_format,
                                                       levels):
    if codec not in av.codecs_available:
        pytest.skip(f'PyAV encodes no {codec} here')
    path = write(tmp_path / name, codec, pixel_format, noise(levels=levels, shape=(64, 80)),
                 made_of='gray' if levels == 256 else pixel_format,
                 b_frames=0 if codec == 'mjpeg' else 2)
    with av.open(str(path)) as container:
        expected = [picture.to_ndarray()[:64] for picture in container.decode(video=0)]
    assert len(expected) == N_FRAMES
    with mock.patch.object(recording_module, 'CACHE_BYTES', 0):
        with open_recording(path) as recording:
            np.testing.assert_array_equal(all_frames(recording), expected)
            for k in reversed(range(len(expected))):
                np.testing.assert_array_equal(recording[k], expected[k])


def test_a_long_video_is_not_held_in_memory(tmp_path):
    frames = noise(60)
    path = write(tmp_path / 'a.mkv', 'ffv1', 'gray', frames)
    with mock.patch.object(recording_module, 'CACHE_BYTES', 3 * frames[0].nbytes):
        with open_recording(path) as recording:
            held = [recording[k] for k in range(3)]
            assert recording[2] is held[2]
            all_frames(recording)
            assert recording[2] is not held[2]


def test_the_command_reads_a_video(tmp_path):
    from track_before_detect.cli import main

    frames = np.full((8, 32, 40), 100, np.uint8)
    frames[:, 16, 20] = 200
    path = write(tmp_path / 'a.mkv', 'ffv1', 'gray', frames)
    assert main(['detect', str(path), '--set', 'threshold=20', '--set',
                 'background=spatial_median', '--output', str(tmp_path / 'out'),
                 '--no-overlay']) == 0


def refuse(path, message):
    """Assert that opening and reading ``path`` fails with one sentence that names it."""
    with pytest.raises(DataError, match=message) as caught:
        with open_recording(path) as recording:
            all_frames(recording)
    assert '\n' not in str(caught.value)
    assert path.name in str(caught.value)


@pytest.mark.parametrize('suffix', ['.mp4', '.avi', '.mkv', '.mov'])
def test_files_that_are_no_video(tmp_path, suffix):
    path = tmp_path / f'a{suffix}'
    path.write_bytes(b'')
    refuse(path, 'is empty')
    path.write_bytes(b'what is written here is no video\n' * 100)
    refuse(path, 'is not a video')


def test_sound_alone(tmp_path):
    path = tmp_path / 'a.mkv'
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('pcm_s16le', rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), 's16', 'mono')
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    refuse(path, 'holds no video stream')


@pytest.mark.parametrize('name, codec, share', [
    ('a.mp4', 'mpeg4', 0.02), ('a.mp4', 'mpeg4', 0.8), ('a.mov', 'libx264', 0.8),
    ('a.mkv', 'ffv1', 0.02), ('a.mkv', 'ffv1', 0.4), ('a.mkv', 'ffv1', 0.8),
    # What follows is no frame but the index.
    ('a.avi', 'ffv1', 0.02), ('a.avi', 'ffv1', 0.4)])
def test_truncated_videos(tmp_path, name, codec, share):
    frames = noise(60)
    path = write(tmp_path / name, codec, 'gray' if codec == 'ffv1' else 'yuv420p', frames)
    whole = path.read_bytes()
    path.write_bytes(whole[:int(share * len(whole))])
    refuse(path, 'truncated|incomplete|no frames|cannot be')


def test_a_truncated_video_whose_index_stands_first(tmp_path):
    path = tmp_path / 'a.mp4'
    write(path, 'libx264', 'gray', noise(60))
    moved = tmp_path / 'b.mp4'
    with av.open(str(path)) as source, \
            av.open(str(moved), 'w', options={'movflags': 'faststart'}) as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                target.mux(packet)
    whole = moved.read_bytes()
    moved.write_bytes(whole[:len(whole) // 2])
    refuse(moved, 'is truncated: it holds .* of 60 frames')


def test_a_damaged_frame_is_named(tmp_path):
    frames = noise(20)
    path = write(tmp_path / 'a.mov', 'png', 'gray', frames)
    whole = bytearray(path.read_bytes())
    middle = len(whole) // 2
    whole[middle:middle + 600] = bytes(600)
    path.write_bytes(whole)
    refuse(path, r'frame \d+ of .* cannot be decoded')


def test_a_name_with_a_colon(tmp_path):
    frames = noise(3)
    path = write(tmp_path / 'a.mkv', 'ffv1', 'gray', frames).rename(tmp_path / 'http:a.mkv')
    with open_recording(path) as recording:
        np.testing.assert_array_equal(all_frames(recording), frames)


def test_without_pyav_the_extra_is_named(tmp_path):
    path = write(tmp_path / 'a.mkv', 'ffv1', 'gray', noise(3))
    script = textwrap.dedent(f"""
        import sys
        sys.modules['av'] = None
        from track_before_detect.errors import MissingExtraError
        from track_before_detect.recordings.open_recording import open_recording
        try:
            open_recording({str(path)!r})
        except MissingExtraError as error:
            print(error)
    """)
    said = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True).stdout
    assert 'track_before_detect[video]' in said
