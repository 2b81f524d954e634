import os
import subprocess
import sys

import numpy as np
import pytest

from track_before_detect.recordings.overlay import (
    colour_of,
    contrast_limits,
    render_overlay,
    write_overlay,
)
from track_before_detect.types import Trajectory


def trajectory(number, positions):
    positions = np.asarray(positions, np.float64)
    n_frames = len(positions)
    return Trajectory(number, positions, np.ones(n_frames), np.zeros((n_frames, 2)),
                      np.arange(n_frames) * 1.0, np.arange(n_frames), 9.0, 3.0)


def noise(shape=(20, 30), dtype=np.float32):
    return (100 + 20 * np.random.default_rng(0).standard_normal(shape)).astype(dtype)


def coloured(picture):
    return (picture != picture[..., :1]).any(axis=2)


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.float32, np.float64, np.complex64])
def test_picture_has_the_size_of_the_frame_and_is_grey_without_trajectories(dtype):
    picture = render_overlay(noise(dtype=dtype), [])
    assert picture.shape == (20, 30, 3) and picture.dtype == np.uint8
    assert not coloured(picture).any()
    assert picture.min() == 0 and picture.max() == 255


def test_line_passes_through_every_pixel_between_positions():
    picture = render_overlay(noise(), [trajectory(4, [(2, 3), (np.nan, np.nan), (12, 3)])])
    expected = np.zeros((20, 30), bool)
    expected[3, 2:13] = True
    np.testing.assert_array_equal(coloured(picture), expected)
    assert tuple(picture[3, 7]) == colour_of(4)


def test_what_is_outside_the_frame_is_cut():
    picture = render_overlay(noise(), [trajectory(1, [(-50, 5), (80, 5)]),
                                       trajectory(2, [(-5, -5)]),
                                       trajectory(3, [(np.nan, np.nan)])])
    expected = np.zeros((20, 30), bool)
    expected[5] = True
    np.testing.assert_array_equal(coloured(picture), expected)


@pytest.mark.parametrize('value', [0.0, 7.5, np.nan, np.inf])
def test_flat_frame_can_be_drawn(value):
    frame = np.full((4, 5), value)
    low, high = contrast_limits(frame)
    assert np.isfinite((low, high)).all() and low < high
    assert render_overlay(frame, []).shape == (4, 5, 3)


def test_few_extreme_pixels_do_not_take_the_contrast():
    frame = noise((200, 200))
    frame[5, 5], frame[6, 6], frame[7, 7] = 1e6, -1e6, np.nan
    low, high = contrast_limits(frame)
    assert 20 < low < 100 < high < 200


@pytest.mark.parametrize('n_trajectories', [0, 1, 50])
@pytest.mark.parametrize('shape', [(20, 30), (1, 300), (300, 4)])
def test_overlay_file_is_written_for_any_number_of_trajectories(tmp_path, n_trajectories, shape):
    pytest.importorskip('matplotlib')
    rng = np.random.default_rng(2)
    trajectories = [trajectory(k, rng.uniform(0, 20, (6, 2))) for k in range(n_trajectories)]
    truth = np.array([[0, 0, 1, 1], [5, 0, 9, 9]], float) if n_trajectories else None
    path = tmp_path / 'overlay.png'
    write_overlay(path, noise(shape), trajectories, truth, 'test', 3)
    assert path.read_bytes().startswith(b'\x89PNG')
    assert os.listdir(tmp_path) == ['overlay.png']


def test_overlay_needs_no_display_and_no_pyplot(tmp_path):
    pytest.importorskip('matplotlib')
    program = (
        'import sys, numpy\n'
        'from track_before_detect.recordings.overlay import write_overlay\n'
        'write_overlay(sys.argv[1], numpy.eye(9), [])\n'
        'sys.exit("matplotlib.pyplot" in sys.modules)\n')
    environment = {name: value for name, value in os.environ.items() if name != 'DISPLAY'}
    subprocess.run([sys.executable, '-c', program, str(tmp_path / 'a.png')], check=True,
                   env=environment, timeout=60)
