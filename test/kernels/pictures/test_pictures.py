"""The loops over the pixels of frames equal what they say in plain words."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.kernels import warp
from track_before_detect.kernels.pictures.boxes import box_mean
from track_before_detect.kernels.pictures.matched_statistic import matched_statistic
from track_before_detect.kernels.pictures.median_over_time import BLOCK, median_over_time


def spoiled(rng, shape, share):
    """Return noise in single precision with a share of NaN, and some infinities."""
    image = rng.normal(size=shape).astype(np.float32)
    odd = rng.random(shape)
    image[odd < share] = np.nan
    image[odd < share / 4] = np.inf
    image[odd < share / 8] = -np.inf
    return image


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 41), st.integers(1, 2 * BLOCK + 3), st.floats(0, 0.9), st.integers(0, 999))
def test_the_median_is_that_of_the_finite_values(n_frames, n_pixels, share, seed):
    frames = spoiled(np.random.default_rng(seed), (n_frames, n_pixels), share)
    found = np.empty(n_pixels, np.float32)
    median_over_time(frames, 2, found)
    for pixel, median in zip(frames.T, found, strict=True):
        finite = pixel[np.isfinite(pixel)]
        assert median == np.median(finite) if len(finite) >= 2 else np.isnan(median)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([(1, 1), (1, 9), (7, 1), (12, 17)]), st.integers(0, 999),
       *[st.integers(-16 * 20, 16 * 20).map(lambda sixteenths: sixteenths / 16)] * 2)
def test_a_shift_is_the_warp_by_a_translation(shape, seed, x, y):
    image = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    image[np.random.default_rng(seed).random(shape) < 0.1] = np.nan
    plain, shifted = np.empty((2, *shape), np.float32)
    warp.warp(image, np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]]), plain)
    warp.shift(image, x, y, shifted)
    np.testing.assert_allclose(shifted, plain, atol=1e-5)


@pytest.mark.parametrize('shape', [(1, 1), (3, 40), (20, 31)])
@pytest.mark.parametrize('side', [1, 5, 31])
def test_the_mean_of_a_box_goes_on_beyond_the_border(shape, side):
    image = np.random.default_rng(3).normal(size=shape).astype(np.float32) + 100
    found = np.empty_like(image)
    box_mean(image, side, found)
    padded = np.pad(image.astype(float), side // 2, mode='edge')
    for y, x in np.ndindex(shape):
        assert found[y, x] == pytest.approx(padded[y:y + side, x:x + side].mean(), rel=1e-6)


@pytest.mark.parametrize('shape', [(1, 1), (4, 30), (25, 20)])
def test_the_matched_statistic_leaves_masked_pixels_out(shape):
    rng = np.random.default_rng(4)
    image = spoiled(rng, shape, 0.2)
    profile = np.exp(-0.5 * (np.arange(-5, 6) / 1.3) ** 2).astype(np.float32)
    found = np.empty_like(image)
    matched_statistic(image, profile, found)
    known = np.isfinite(image)
    stamp = np.outer(profile, profile).astype(float)
    signal = ndimage.correlate(np.where(known, image, 0).astype(float), stamp, mode='constant')
    power = ndimage.correlate(known.astype(float), stamp ** 2, mode='constant')
    expected = np.full(shape, np.nan)
    expected[known] = signal[known] / np.sqrt(power[known])
    np.testing.assert_allclose(found, expected, atol=1e-5)
