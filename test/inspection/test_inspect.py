"""The page of an inspection: complete, self-contained, with words for what is wrong."""

import base64
from html.parser import HTMLParser
import io
import logging

import numpy as np
from PIL import Image
import pytest
from scipy import ndimage

from track_before_detect.cli import main
from track_before_detect.inspection.findings import findings
from track_before_detect.inspection.observation import Observation
from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.recording import Recording
from track_before_detect.tracking.recording import detect_recording

N_FRAMES, SHAPE = 10, (40, 48)
SECTIONS = ['What looks wrong', 'In numbers', 'What the detector sees', 'Trajectories',
            'Candidates that are no targets', 'Remarks', 'Options']
PICTURES = ['Registered mean', 'Best path', 'Residual', 'Noise map', 'Matched filter',
            'Motion of the scene', 'Whiteness']


def frames_with_target(seed=1, peak=4.0, speed=0.5):
    frames = np.random.default_rng(seed).standard_normal((N_FRAMES, *SHAPE))
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    for t, frame in enumerate(frames):
        frame += peak * np.exp(-0.5 * ((x - 20 - speed * t) ** 2 + (y - 18) ** 2))
    return frames


class Parts(HTMLParser):
    """Headings, and everything that a browser would load."""

    def __init__(self, text):
        super().__init__()
        self.headings, self.loaded, self.scripts, self._in_heading = [], [], 0, False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.loaded += [value for name, value in attributes
                        if name in ('src', 'href', 'srcset', 'data', 'poster', 'action')]
        self.scripts += tag == 'script'
        self._in_heading = tag == 'h2'

    def handle_data(self, data):
        if self._in_heading:
            self.headings.append(data)
            self._in_heading = False


@pytest.fixture
def quiet_logging(monkeypatch):
    """Keep the command from configuring the logging of the tests."""
    monkeypatch.setattr(logging, 'basicConfig', lambda **_: None)


@pytest.mark.usefixtures('quiet_logging')
def test_the_page_holds_everything_and_loads_nothing(tmp_path, capsys):
    np.savez(tmp_path / 'a<b>.npz', frames=frames_with_target())
    assert main(['inspect', str(tmp_path / 'a<b>.npz'), '--output', str(tmp_path / 'out'), '--set',
                 'calibration=clutter', '--set', 'background=either', '--set',
                 'noise=robust']) == 0
    text = (tmp_path / 'out' / 'inspect.html').read_text(encoding='utf-8')
    parts = Parts(text)
    assert parts.headings == SECTIONS
    assert parts.scripts == 0
    assert all(f'alt="{name}' in text for name in PICTURES)
    assert 'a&lt;b&gt;' in text and 'a<b>' not in text
    # Its stamps are made up.
    assert 'speed [px/frame]' in text and 'speed [px/s]' not in text
    assert len(parts.loaded) >= len(PICTURES) + 4
    for source in parts.loaded:
        kind, _, content = source.partition(',')
        assert kind == 'data:image/png;base64'
        Image.open(io.BytesIO(base64.b64decode(content))).verify()
    assert '@import' not in text and 'url(' not in text
    with Image.open(tmp_path / 'out' / 'inspect.png') as picture:
        assert picture.width > 1000
    assert 'written' in capsys.readouterr().out


@pytest.mark.usefixtures('quiet_logging')
def test_an_output_that_is_a_file_is_refused_before_the_search(tmp_path, capsys):
    (tmp_path / 'taken').write_text('')
    assert main(['inspect', str(tmp_path / 'missing.npz'), '--output',
                 str(tmp_path / 'taken')]) == 2
    assert '--output must be a folder' in capsys.readouterr().err


def inspected(frames, **options):
    """Return what was seen of frames, and the words for what looks wrong."""
    settings = DetectorOptions(**options)
    observed = Observation(len(frames) // 2)
    recording = Recording('a', frames.shape[1:], frames.dtype, len(frames), Frames(frames))
    result = detect_recording(recording, settings, observe=observed)
    observed.add_motion_of_the_scene()
    return observed, findings(observed, result, len(recording))


class Frames:
    """An array, read as a recording."""

    def __init__(self, frames):
        self._frames = frames

    def read(self, index):
        return self._frames[index]

    def close(self):
        pass


def test_a_target_in_noise_looks_right():
    observed, words = inspected(frames_with_target(), threshold=8.0)
    assert words == []
    assert observed.frames_searched() == N_FRAMES
    assert observed.strongest()[1][0] > 1


def test_what_is_below_the_threshold_is_said_with_its_ratio():
    observed, words = inspected(frames_with_target(peak=0.0), threshold=40.0)
    (word,) = words
    assert f'reaches {observed.strongest()[1][0]:.2f} of it' in word
    assert 0.05 < observed.strongest()[1][0] < 1


def test_a_background_that_is_left_is_named():
    _, words = inspected(0.3 * frames_with_target(peak=0.0) + 5, threshold=1000.0)
    assert any('background=temporal_median' in word for word in words)
    assert any('noise=robust' in word for word in words)


def test_noise_that_is_not_white_is_named():
    blurred = ndimage.gaussian_filter(frames_with_target(peak=0.0), (0, 1, 1))
    steady = frames_with_target(peak=0.0) + np.random.default_rng(2).standard_normal(SHAPE)
    assert any('not white in space' in word
               for word in inspected(blurred / blurred.std(), threshold=90.0)[1])
    assert any('not white in time' in word and 'background=temporal_median' in word
               for word in inspected(steady, threshold=90.0)[1])
    assert not any('white' in word for word in inspected(
        steady, threshold=90.0, background='temporal_median', noise='robust')[1])


def test_a_scene_that_moves_is_named_unless_it_is_registered():
    rng = np.random.default_rng(3)
    scene = ndimage.gaussian_filter(rng.standard_normal((90, 120)), 1) * 40
    frames = np.stack([scene[:, t:t + 100] for t in range(N_FRAMES)])
    frames += rng.standard_normal(frames.shape)
    options = {'background': 'temporal_median', 'noise': 'robust', 'threshold': 90.0}
    observed, words = inspected(frames, **options)
    assert any('moves by 1.0' in word and 'registration=translation' in word for word in words)
    observed, words = inspected(frames, **options, registration='translation')
    assert not any('moves by' in word for word in words)
    _, motion, sure = observed.motion()
    assert sure.all()
    assert np.abs(motion - (-1, 0)).max() < 0.1


def test_frames_that_repeat_are_counted():
    frames = np.repeat(frames_with_target(), [1] * 4 + [2] * 6, axis=0)
    observed, words = inspected(frames, threshold=8.0)
    assert observed.frames_searched() == N_FRAMES
    assert any('6 of 16 frames were not searched' in word for word in words)


def test_pixels_without_data_are_counted():
    frames = frames_with_target()
    frames[:, :, 36:] = np.nan
    observed, words = inspected(frames, threshold=8.0)
    assert observed.all_facts()[0].no_data == pytest.approx(0.25)
    assert any('25 % of the pixels' in word for word in words)


def test_candidates_that_are_all_rejected_are_named():
    frames = frames_with_target(peak=0.0)
    frames[:, 20, 12:36] += 8
    _, words = inspected(frames, calibration='clutter')
    (word,) = [word for word in words if 'Nothing' in word]
    assert 'above the threshold' in word and 'edge-like' in word
