"""The deviation is right in noise and survives what is not noise."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.preprocess.robust import robust_deviation


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
