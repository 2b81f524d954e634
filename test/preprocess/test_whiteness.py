"""Noise that is not white is scaled by what the matched filter sees of it."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.preprocess.whiteness import coloured_noise_factor


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
