"""The noise level is right in noise and survives what is not noise."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.preprocess.noise import (
    correlation_factor,
    frame_level,
    pixel_level,
    robust_deviation,
)


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.integers(0, 99))
def test_deviation_of_gaussian_noise_is_within_two_percent(sigma, mean, seed):
    values = mean + sigma * np.random.default_rng(seed).normal(size=40_000)
    assert robust_deviation(values) == pytest.approx(sigma, rel=0.02)


def test_a_tenth_of_bright_values_changes_the_deviation_little():
    values = np.random.default_rng(0).normal(size=40_000)
    values[::10] = 100.0
    assert robust_deviation(values) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize('sigma', [0.6, 0.8, 1.5, 4.0])
def test_rounded_noise_shows_no_steps(sigma):
    values = np.rint(np.random.default_rng(1).normal(0, sigma, 40_000))
    assert robust_deviation(values, floor=0.3) == pytest.approx(np.hypot(sigma, 12 ** -0.5),
                                                                rel=0.05)


def test_deviation_does_not_fall_below_the_floor():
    assert robust_deviation(np.zeros(100), floor=0.3) == 0.3
    assert robust_deviation(np.zeros(100)) == 0.0
    assert np.isnan(robust_deviation(np.full(4, np.nan), floor=0.3))


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


@pytest.mark.parametrize('sigma_px', [0.7, 1.0, 2.0])
def test_correlated_noise_leaves_the_matched_filter_at_unit_variance(sigma_px):
    rng = np.random.default_rng(4)
    frames = ndimage.gaussian_filter(rng.normal(size=(8, 96, 96)), (0, 1, 1), mode='wrap')
    frames /= frames.std()
    profile = np.exp(-0.5 * (np.arange(-9, 10) / sigma_px) ** 2)
    profile /= np.linalg.norm(profile)
    output = ndimage.correlate1d(ndimage.correlate1d(frames, profile, axis=1, mode='wrap'),
                                 profile, axis=2, mode='wrap')
    assert correlation_factor(frames, sigma_px) == pytest.approx(output.std(), rel=0.03)


def test_white_noise_needs_no_correction():
    frames = np.random.default_rng(5).normal(size=(8, 64, 64))
    assert correlation_factor(frames, 1.0) == 1.0


def test_the_map_of_constant_pixels_without_a_floor_is_zero_in_silence():
    with np.errstate(all='raise'):
        assert np.all(pixel_level(np.full((6, 8, 8), 5.0)) == 0)
