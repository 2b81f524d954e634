import gc

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.recordings.overlay import colour_of, COLOURS
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.film import check_film, write_film
from track_before_detect.types import Trajectory

Image = pytest.importorskip('PIL.Image', reason='the extra [video] is missing')
SHAPE = 25, 401
# Pixels of the film for one of the frame: the long side comes near to 1280.
FACTOR = 3


class Source:
    """Frames of noise; may count the pictures that are held when the next one is read."""

    def __init__(self, dtype=np.float32, counts=False):
        self.dtype, self.counts = dtype, counts
        self.read_frames, self.most_held = [], 0

    def read(self, index):
        self.read_frames.append(index)
        if self.counts:
            # By type: to ask a proxy of something gone for its class is an error.
            pictures = sum(issubclass(type(held), Image.Image) for held in gc.get_objects())
            self.most_held = max(self.most_held, pictures)
        return np.random.default_rng(index).normal(100, 5, SHAPE).astype(self.dtype)

    def close(self):
        pass


def recording(n_frames, fps, dtype=np.float32, counts=False):
    source = Source(dtype, counts)
    return Recording('a', SHAPE, dtype, n_frames, source, np.arange(n_frames) / fps), source


def moving(first, last, y, number=3):
    """Return a target that moves by half a pixel in each of its frames, from x = 5."""
    frames = np.arange(first, last + 1)
    positions = np.column_stack([5 + 0.5 * (frames - first), np.full(len(frames), float(y))])
    return Trajectory(number, positions, np.ones(len(frames)), np.zeros_like(positions),
                      frames / 10, frames, 12.0, 4.25)


def frames_of(path):
    """Return all pictures of a film, (T, H, W, 3)."""
    if path.suffix == '.gif':
        with Image.open(path) as film:
            pictures = []
            for k in range(film.n_frames):
                film.seek(k)
                pictures.append(np.asarray(film.convert('RGB')))
            return np.array(pictures), film.info['duration'] / 1000
    av = pytest.importorskip('av', reason='the extra [video] is missing')
    with av.open(str(path)) as film:
        pictures = [frame.to_ndarray(format='rgb24') for frame in film.decode(video=0)]
        return np.array(pictures), float(1 / film.streams.video[0].average_rate)


@pytest.mark.parametrize('name', ['a.gif', 'a.mp4'])
def test_a_target_is_drawn_where_it_is_with_a_trail_of_a_second(name, tmp_path):
    if name == 'a.mp4':
        pytest.importorskip('av', reason='the extra [video] is missing')
    filmed, source = recording(16, fps=5.0)
    write_film(tmp_path / name, filmed, [moving(2, 9, y=12)])
    assert source.read_frames == list(range(16))
    pictures, interval = frames_of(tmp_path / name)
    assert interval == pytest.approx(0.2)
    assert len(pictures) == 16
    differences = np.abs(pictures[6, 37, 19].astype(int) - COLOURS).sum(axis=1)
    assert COLOURS[differences.argmin()] == colour_of(3)
    assert differences.min() == 0 or name == 'a.mp4'
    coloured = np.ptp(pictures, axis=-1) > 50
    on_path = coloured[:, 12 * FACTOR + FACTOR // 2]
    for frame in range(16):
        columns = np.flatnonzero(on_path[frame])
        if not 2 <= frame < 9 + 5:
            assert not coloured[frame].any(), frame
        elif frame <= 9:
            # From where it was a second ago to the far side of the ring around it.
            first, last = (5.5 + 0.5 * (k - 2) for k in (max(2, frame - 4), frame))
            assert columns.min() == pytest.approx(
                min(first * FACTOR, last * FACTOR - 9), abs=3), frame
            assert columns.max() == pytest.approx(last * FACTOR + 9, abs=3), frame
    # The label is above; without the target there is neither ring nor label.
    above = slice(0, 12 * FACTOR)
    assert coloured[6, above].sum() > 60 and not coloured[12, above].any()


def test_no_more_than_a_few_frames_are_held(tmp_path):
    # Beyond what a recording keeps itself, which is bounded.
    for n_frames in (8, 24):
        filmed, source = recording(n_frames, 25.0, counts=True)
        write_film(tmp_path / f'{n_frames}.gif', filmed, [moving(0, n_frames - 1, 9)])
        assert source.most_held <= 6, n_frames
    sizes = [(tmp_path / f'{n}.gif').stat().st_size for n in (8, 24)]
    assert sizes[1] == pytest.approx(3 * sizes[0], rel=0.2)


@pytest.mark.parametrize(('fps', 'shown_s'), [(0.1, 0.2), (25.0, 0.04), (1000.0, 0.02)])
def test_slow_and_fast_recordings_are_shown_at_a_rate_that_can_be_watched(
        fps, shown_s, tmp_path):
    write_film(tmp_path / 'a.gif', recording(3, fps)[0], [])
    assert frames_of(tmp_path / 'a.gif')[1] == pytest.approx(shown_s)


def test_contrast_does_not_jump_with_one_frame(tmp_path):
    filmed, _ = recording(6, 5.0)
    frames = [filmed[k].copy() for k in range(6)]
    frames[3] += 1000

    class Jump(Source):
        def read(self, index):
            return frames[index]

    jumping = Recording('a', SHAPE, np.float32, 6, Jump(), np.arange(6) / 5)
    write_film(tmp_path / 'a.gif', jumping, [])
    levels = frames_of(tmp_path / 'a.gif')[0].mean(axis=(1, 2, 3))
    assert levels[3] > 250
    assert levels[4] == pytest.approx(levels[2], rel=0.1)


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.complex64])
def test_all_kinds_of_pixels_are_filmed(dtype, tmp_path):
    write_film(tmp_path / 'a.gif', recording(2, 5.0, dtype)[0], [])
    pictures, _ = frames_of(tmp_path / 'a.gif')
    assert pictures.shape == (2, SHAPE[0] * FACTOR, SHAPE[1] * FACTOR, 3)
    assert pictures.min() < 20 and pictures.max() > 235


def test_what_is_done_is_told(tmp_path):
    told = []
    write_film(tmp_path / 'a.gif', recording(4, 5.0)[0], [],
               lambda label, done: told.append((label, done)))
    assert told == [('drawing a.gif', k / 4) for k in range(4)]


@pytest.mark.parametrize('name', ['a.avi', 'folder/a.mp4', '/a.gif', 'mp4', '.mp4', ''])
def test_a_film_of_another_kind_or_in_another_folder_is_refused(name):
    with pytest.raises(ParameterError, match='ends with .mp4 or .gif'):
        check_film(name)
