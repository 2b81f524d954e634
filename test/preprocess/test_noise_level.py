"""The noise level follows the noise from frame to frame and over the image."""

import numpy as np
import pytest

from track_before_detect.preprocess.noise_level import frame_level, pixel_level


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
