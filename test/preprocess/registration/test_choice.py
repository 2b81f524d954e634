"""A batch is registered by the simplest map beside which no other leaves less of the scene."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.prepare import prepare
from track_before_detect.preprocess.registration.choice import register_simply
from track_before_detect.preprocess.registration.correlation import features_of
from track_before_detect.preprocess.registration.registration import register
from track_before_detect.types import FrameBatch

N_FRAMES, HEIGHT, WIDTH = 12, 120, 160
MIDDLE = np.array([0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)])


def texture(rng, shape):
    picture = sum(side * ndimage.gaussian_filter(rng.standard_normal(shape), side)
                  for side in (1.5, 4, 12))
    return 20 * picture / picture.std()


def seen_by(rng, matrices):
    """Return frames of a scene that is where matrices (T, 2, 3) take pixels to, with noise."""
    wide = texture(rng, (HEIGHT + 80, WIDTH + 80))
    points = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)
    frames = [ndimage.map_coordinates(
        wide, (points @ matrix[:, :2].T + matrix[:, 2] + 40).transpose(2, 0, 1)[::-1], order=3)
        for matrix in matrices]
    return (100 + np.array(frames) + 2 * rng.standard_normal((N_FRAMES, HEIGHT, WIDTH))).astype(
        np.float32)


def simply(frames):
    return register_simply([features_of(frame) for frame in frames])


def shift_by(pixels):
    return [np.column_stack([np.eye(2), np.array([1.0, -0.4]) * pixels * t])
            for t in range(N_FRAMES)]


def turn_by(degrees):
    matrices = []
    for t in range(N_FRAMES):
        c, s = np.cos(np.deg2rad(degrees * t)), np.sin(np.deg2rad(degrees * t))
        turn = np.array([[c, -s], [s, c]])
        matrices.append(np.column_stack([turn, MIDDLE - turn @ MIDDLE]))
    return matrices


@pytest.mark.parametrize('seed', [1, 2, 3])
@pytest.mark.parametrize(('matrices', 'kind'), [
    (shift_by(0.0), 'none'), (shift_by(0.3), 'translation'), (shift_by(2.2), 'translation'),
    (turn_by(0.25), 'affine')], ids=['still', 'slow', 'fast', 'turns'])
def test_the_kind_of_a_motion_is_found(matrices, kind, seed):
    frames = seen_by(np.random.default_rng(seed), matrices)
    found = simply(frames)
    assert found.credible.all()
    expected = register(frames, kind).maps if kind != 'none' else np.broadcast_to(
        np.eye(3), (N_FRAMES, 3, 3))
    np.testing.assert_array_equal(found.maps, expected)


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_leaves_in_the_wind_do_not_move_a_still_camera(seed):
    rng = np.random.default_rng(seed)
    still = np.where(np.arange(HEIGHT)[:, None] < 60, texture(rng, (HEIGHT, WIDTH)), 0.0)
    leaves, phase = texture(rng, (HEIGHT, WIDTH)), rng.uniform(0, 6, 8)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    frames = []
    for t in range(N_FRAMES):
        # Eight trees, each by itself.
        sway = np.repeat(np.sin(0.9 * t + phase), WIDTH // 8)
        frames.append(np.where(
            y < 60, still, ndimage.map_coordinates(leaves, [y, x + sway], order=3, mode='wrap')))
    frames = (np.array(frames) + 2 * rng.standard_normal((N_FRAMES, HEIGHT, WIDTH)))
    np.testing.assert_array_equal(simply(frames.astype(np.float32)).maps,
                                  np.broadcast_to(np.eye(3), (N_FRAMES, 3, 3)))


def test_frames_without_a_scene_stay_where_they_are():
    noise = np.random.default_rng(5).standard_normal((N_FRAMES, 64, 64)).astype(np.float32)
    assert not simply(noise).offsets.any()


def test_columns_of_the_sensor_are_taken_off_where_the_scene_moves():
    rng = np.random.default_rng(4)
    columns = 15 * rng.standard_normal(WIDTH)
    frames = seen_by(rng, shift_by(2.2)) + columns
    options = DetectorOptions(registration='translation', background='temporal_median',
                              search_plane='image')
    left = prepare(FrameBatch.of(frames, np.arange(float(N_FRAMES))), options, 1.5).frames
    assert np.nanstd(np.nanmedian(left, axis=(0, 1))) < 1.0
