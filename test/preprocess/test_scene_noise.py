"""The noise of a pixel follows the brightness and the slopes of the scene, and nothing else."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.kernels.pictures.scene_noise import noise_at, terms_at
from track_before_detect.preprocess.background import remove_temporal_median
from track_before_detect.preprocess.scene_noise import scene_noise

RNG = np.random.default_rng(3)
STILL = np.broadcast_to(np.eye(3), (16, 3, 3))
SCENE = 40 * ndimage.gaussian_filter(RNG.standard_normal((96, 128)), 3) / 0.094 + 200


def left_of(frames):
    frames = frames.astype(np.float32)
    return frames, remove_temporal_median(frames, STILL[:len(frames)])


def spread(values):
    return 1.4826 * np.nanmedian(np.abs(values))


def test_bright_pixels_of_a_photon_count_have_more_noise():
    scene = np.where(np.arange(128) < 64, 25.0, 400.0) + np.zeros((96, 1))
    frames, residual = left_of(RNG.poisson(scene, (16, 96, 128)))
    even = residual / scene_noise(residual, frames)
    # Off the slope between the halves.
    assert spread(residual[:, :, 70:]) / spread(residual[:, :, :58]) == pytest.approx(4, rel=0.1)
    assert spread(even[:, :, 70:]) / spread(even[:, :, :58]) == pytest.approx(1, abs=0.07)


def test_slopes_of_a_scene_that_shakes_have_more_noise():
    shaken = [ndimage.shift(SCENE, RNG.normal(0, 0.4, 2), mode='nearest') for _ in range(16)]
    frames, residual = left_of(shaken + RNG.standard_normal((16, 96, 128)))
    even = residual / scene_noise(residual, frames)
    slope = np.hypot(*np.gradient(SCENE))
    steep, flat = slope > np.quantile(slope, 0.9), slope < np.quantile(slope, 0.1)
    assert spread(residual[:, steep]) > 4 * spread(residual[:, flat])
    assert spread(even[:, steep]) < 2 * spread(even[:, flat])


def test_white_noise_on_a_still_scene_stays_even():
    frames, residual = left_of(SCENE + 3 * RNG.standard_normal((16, 96, 128)))
    noise = scene_noise(residual, frames)
    assert np.median(noise) == pytest.approx(1, abs=0.01)
    assert np.std(noise) < 0.05


def test_a_bright_slow_target_does_not_raise_the_noise_of_its_place():
    frames = SCENE + 3 * RNG.standard_normal((16, 96, 128))
    y, x = np.mgrid[:96, :128]
    for t, frame in enumerate(frames):
        frame += 60 * np.exp(-((y - 40)**2 + (x - 50 - 0.5 * t)**2) / 4)
    frames, residual = left_of(frames)
    assert scene_noise(residual, frames)[:, 37:44, 47:62].max() < 1.3


def test_masked_pixels_have_no_noise_and_take_none_from_those_beside():
    frames, residual = left_of(SCENE + 3 * RNG.standard_normal((16, 96, 128)))
    frames[:, 20, 30] = residual[:, 20, 30] = np.nan
    noise = scene_noise(residual, frames)
    assert np.isnan(noise[:, 20, 30]).all() and np.isnan(noise).sum() == 16


@pytest.mark.parametrize('frames', [np.full((4, 48, 48), 7.0), np.full((4, 48, 48), np.nan),
                                    np.ones((2, 3, 3))])
def test_without_noise_or_pixels_nothing_is_known(frames):
    frames = frames.astype(np.float32)
    assert scene_noise(frames - frames, frames) is None


def slowly(frame, residual):
    background = frame - residual
    rows, columns = np.gradient(background)
    return residual**2, background, rows**2 + columns**2


def test_the_kernels_agree_with_plain_numpy():
    frame, residual = RNG.standard_normal((2, 9, 11)).astype(np.float32)
    expected = np.stack([term.ravel() for term in slowly(frame, residual)], axis=1)
    found = np.empty((len(range(2, 99, 4)), 3))
    terms_at(frame, residual, 2, 4, found)
    np.testing.assert_allclose(found, expected[2::4], rtol=1e-5, atol=1e-6)
    noise = np.empty_like(frame)
    noise_at(frame, residual, -1.0, np.array([0.5, 0.3, 0.2]), 0.6, noise)
    _, brightness, slope = slowly(frame, residual)
    variance = 0.5 + 0.3 * np.maximum(brightness + 1, 0) + 0.2 * slope
    np.testing.assert_allclose(noise, np.sqrt(np.maximum(variance, 0.6)), rtol=1e-5)
