"""The noise level follows the noise from frame to frame and over the image."""

import numpy as np
import pytest

from naive import ring_level
from track_before_detect import geometry
from track_before_detect.preprocess.noise_level import (
    frame_level,
    lasting_level,
    local_level,
    pixel_level,
)


def test_each_frame_has_its_own_level():
    sigmas = np.array([1.0, 3.0, 0.5])
    frames = np.random.default_rng(2).normal(size=(3, 150, 150)) * sigmas[:, None, None]
    frames[:, 20:30, :] = np.nan
    frames = np.concatenate([frames, np.full((1, 150, 150), np.nan)])
    level = frame_level(frames)
    assert level.shape == (4, 1, 1)
    np.testing.assert_allclose(level[:3, 0, 0], sigmas, rtol=0.02)
    assert np.isnan(level[3])


def test_the_map_follows_the_noise_over_the_image():
    frames = np.random.default_rng(3).normal(size=(20, 64, 64))
    frames[:, :, 32:] *= 4.0
    frames[:, 5, 5] = np.nan
    level = pixel_level(frames)
    assert level.shape == (1, 64, 64)
    assert np.isnan(level[0, 5, 5])
    assert np.nanmedian(level[0, :, :28]) == pytest.approx(1.0, rel=0.05)
    assert np.nanmedian(level[0, :, 36:]) == pytest.approx(4.0, rel=0.05)


def test_the_map_of_constant_pixels_is_the_floor():
    assert np.all(pixel_level(np.full((6, 8, 8), 5.0), floor=0.3) == 0.3)


def test_the_map_of_constant_pixels_without_a_floor_is_zero_in_silence():
    with np.errstate(all='raise'):
        assert np.all(pixel_level(np.full((6, 8, 8), 5.0)) == 0)


@pytest.mark.parametrize('width_px', [1.0, 1.5])
@pytest.mark.parametrize('shape', [(2, 30, 41), (1, 1, 50), (1, 9, 7)])
def test_local_level_is_that_of_the_ring_or_of_the_frame(width_px, shape):
    rng = np.random.default_rng(8)
    frames = rng.normal(size=shape) * np.linspace(0.2, 5, shape[2])
    frames[0, 0, 3:6] = np.nan
    for frame in frames:
        np.testing.assert_allclose(local_level(frame, 0.01, width_px),
                                   ring_level(frame, 0.01, width_px), rtol=1e-5)


def test_local_level_follows_leftovers_and_leaves_a_target_its_height():
    frame = np.random.default_rng(9).normal(size=(80, 80))
    frame[:, 50:] *= 10
    calm = local_level(frame, 0.0, 1.5)
    assert np.median(calm[20:60, 65:]) == pytest.approx(10, rel=0.15)
    frame[40, 20] += 1000
    assert local_level(frame, 0.0, 1.5)[40, 20] == pytest.approx(calm[40, 20], rel=0.02)


def test_local_level_of_a_masked_frame_is_unknown_and_of_frames_without_noise_the_floor():
    assert np.all(local_level(np.zeros((20, 20)), 0.3, 1.5) == np.float32(0.3))
    assert np.isnan(local_level(np.full((20, 20), np.nan), 0.3, 1.5)).all()


@pytest.mark.parametrize('pan', [0, 2])
def test_lasting_level_is_that_of_the_sum_over_frames_wherever_the_scene_is(pan):
    rng = np.random.default_rng(10)
    scene = 0.5 * rng.normal(size=(60, 120))
    scene[:, :50] = 0
    frames = np.array([scene[:, pan * t:pan * t + 90] for t in range(16)])
    frames += rng.normal(size=frames.shape)
    frames[3, 5, 60:] = np.nan
    offsets = -pan * np.arange(16.0)[:, None] * [1, 0]
    level = np.broadcast_to(lasting_level(
        frames.astype(np.float32), geometry.translations(offsets), 1.0), frames.shape)
    for t in (0, 15):
        begins = 50 - pan * t
        assert np.median(level[t, :, :begins - 8]) == pytest.approx(1, rel=0.1)
        assert np.median(level[t, :, begins + 8:]) == pytest.approx(5**0.5, rel=0.1)


def test_lasting_level_leaves_a_target_that_stays_its_height():
    frames = np.random.default_rng(11).normal(size=(16, 40, 40)).astype(np.float32)
    still = geometry.translations(np.zeros((16, 2)))
    calm = lasting_level(frames, still, 1.0)
    frames[:, 20, 20] += 100
    assert lasting_level(frames, still, 1.0)[0, 20, 20] == pytest.approx(calm[0, 20, 20], rel=0.02)
