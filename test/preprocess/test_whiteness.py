"""Noise that is not white is scaled by what the matched filter sees of it."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.preprocess.whiteness import (
    autocorrelation,
    coloured_noise_factor,
    differ_by_white_noise,
    matched_statistic,
)


@pytest.mark.parametrize('sigma_px', [0.7, 1.0, 2.0])
def test_correlated_noise_leaves_the_matched_filter_at_unit_variance(sigma_px):
    rng = np.random.default_rng(4)
    frames = ndimage.gaussian_filter(rng.normal(size=(8, 96, 96)), (0, 1, 1), mode='wrap')
    frames /= frames.std()
    profile = np.exp(-0.5 * (np.arange(-9, 10) / sigma_px) ** 2)
    profile /= np.linalg.norm(profile)
    output = ndimage.correlate1d(ndimage.correlate1d(frames, profile, axis=1, mode='wrap'),
                                 profile, axis=2, mode='wrap')
    assert coloured_noise_factor(frames, sigma_px) == pytest.approx(output.std(), rel=0.03)


def test_white_noise_needs_no_correction():
    frames = np.random.default_rng(5).normal(size=(8, 64, 64))
    assert coloured_noise_factor(frames, 1.0) == 1.0


@pytest.mark.parametrize('kind', ['real', 'complex'])
def test_autocorrelation_of_a_moving_average_is_known(kind):
    rng = np.random.default_rng(5)
    white = rng.standard_normal((2, 30, 80, 90))
    noise = white[0] if kind == 'real' else white[0] + 1j * white[1]
    mean = noise[:, :, 1:] + noise[:, :, :-1]
    mean[:, 3, 4] = np.nan
    assert autocorrelation(mean, 2, 3) == pytest.approx([1, 0.5, 0, 0], abs=0.02)
    assert autocorrelation(mean, 1, 3) == pytest.approx([1, 0, 0, 0], abs=0.02)
    assert autocorrelation(mean, 0, 3) == pytest.approx([1, 0, 0, 0], abs=0.02)


def test_matched_statistic_has_unit_noise_and_the_snr_of_a_target():
    frame = np.random.default_rng(6).standard_normal((90, 90))
    frame[:, 80:] = np.nan
    y, x = np.mgrid[:90, :90]
    picture = np.exp(-0.5 * ((x - 40) ** 2 + (y - 50) ** 2) / 1.5**2)
    seen = matched_statistic(frame + 1000 * picture / np.linalg.norm(picture), 1.5)
    assert seen[50, 40] == pytest.approx(1000, rel=0.01)
    assert np.isnan(seen[:, 80:]).all()
    away = matched_statistic(frame, 1.5)[:, :80]
    assert away.std() == pytest.approx(1, abs=0.1)


def moving_scene(noise, step=1):
    """Return frames of a smooth scene that moves by whole pixels, with white noise."""
    rng = np.random.default_rng(11)
    scene = 30 * ndimage.gaussian_filter(rng.normal(size=(96, 140)), 2, mode='wrap') / 0.14
    return np.stack([scene[:, step * t:step * t + 96] for t in range(10)]) + noise * rng.normal(
        size=(10, 96, 96))


@pytest.mark.parametrize(('frames', 'white'), [
    (moving_scene(0.0), False), (moving_scene(3.0), False), (moving_scene(40.0), True),
    (np.rint(moving_scene(40.0)), True), (moving_scene(3.0, step=0), True),
    (moving_scene(0.0, step=0), False),
    (ndimage.gaussian_filter(moving_scene(40.0, step=0), (0, 0.6, 0.6)), False)])
def test_what_changes_is_white_where_the_noise_of_pixels_outweighs_the_scene(frames, white):
    assert differ_by_white_noise(frames) is white
    frames[:, 10:14] = np.nan
    assert differ_by_white_noise(frames) is white
