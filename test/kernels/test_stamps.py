"""Stamps are unit norm, cut at borders and masks, and equal a picture drawn pixel by pixel."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels import stamps as kernel

NO_MASK = np.zeros((0, 0, 0), bool)
SHAPE = (11, 14)


def render(positions, sigma, valid=NO_MASK, half=4):
    stamps = np.empty((len(positions), 2 * half + 1, 2 * half + 1))
    origins = np.empty((len(positions), 2), np.int64)
    kernel.render_gaussian(positions, sigma, half, *SHAPE, valid, stamps, origins)
    return stamps, origins


POSITIONS = np.array([[5.2, 4.9], [0.0, 10.0], [13.0, 0.4], [6.5, 6.5]])


@pytest.fixture
def valid():
    return np.random.default_rng(1).random((len(POSITIONS), *SHAPE)) > 0.3


@pytest.mark.parametrize('masked', [False, True])
def test_drawn_stamps_equal_the_picture(masked, valid):
    stamps, origins = render(POSITIONS, 1.0, valid if masked else NO_MASK)
    frames = np.zeros((len(POSITIONS), *SHAPE), np.float32)
    kernel.accumulate(frames, stamps, origins, np.arange(1.0, 5))
    for t, position in enumerate(POSITIONS):
        picture = naive.gaussian_stamp(SHAPE, position, 1.0, 4, valid[t] if masked else None)
        np.testing.assert_allclose(frames[t], (t + 1) * picture, atol=1e-6)


@pytest.mark.parametrize('masked', [False, True])
def test_correlation_is_the_adjoint_of_drawing(masked, valid):
    generator = np.random.default_rng(2)
    stamps, origins = render(POSITIONS, 1.0, valid if masked else NO_MASK)
    amplitudes = generator.standard_normal(len(POSITIONS))
    data = generator.standard_normal((len(POSITIONS), *SHAPE)).astype(np.float32)
    drawn = np.zeros_like(data)
    kernel.accumulate(drawn, stamps, origins, amplitudes)
    seen = np.empty(len(POSITIONS))
    kernel.correlate(stamps, origins, data, seen)
    assert np.sum(drawn.astype(float) * data) == pytest.approx(amplitudes @ seen, rel=1e-5)


def test_overlap_is_the_inner_product_of_two_pictures(valid):
    others = POSITIONS + np.array([[1.3, -0.6], [3.0, -2.0], [-7.9, 0.0], [-20, 0]])
    others = np.clip(others, 0, [SHAPE[1] - 1, SHAPE[0] - 1])
    a, b = render(POSITIONS, 1.0, valid), render(others, 1.0, valid)
    out = np.empty(len(POSITIONS))
    kernel.overlap(*a, *b, out)
    for t in range(len(POSITIONS)):
        expected = np.sum(naive.gaussian_stamp(SHAPE, POSITIONS[t], 1.0, 4, valid[t])
                          * naive.gaussian_stamp(SHAPE, others[t], 1.0, 4, valid[t]))
        assert out[t] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize('masked', [False, True])
def test_statistic_equals_stamp_and_slope_equals_difference_quotient(masked, valid):
    data = np.random.default_rng(4).standard_normal((len(POSITIONS), *SHAPE)).astype(np.float32)
    mask = valid if masked else NO_MASK
    data[~valid] *= not masked
    out = np.empty((len(POSITIONS), 3))
    kernel.statistic_and_slope(POSITIONS, 1.0, 4, data, mask, out)
    seen = np.empty(len(POSITIONS))
    kernel.correlate(*render(POSITIONS, 1.0, mask), data, seen)
    np.testing.assert_allclose(out[:, 0], seen, atol=1e-9)
    if masked:
        return
    interior = 0
    for axis in (0, 1):
        shifted = np.empty_like(out)
        moved = POSITIONS.copy()
        moved[:, axis] += 1e-5
        kernel.statistic_and_slope(moved, 1.0, 4, data, mask, shifted)
        slope = (shifted[interior, 0] - out[interior, 0]) / 1e-5
        assert out[interior, 1 + axis] == pytest.approx(slope, abs=2e-3)


def test_stamp_without_a_valid_pixel_is_zero():
    stamps, _ = render(POSITIONS, 1.0, np.zeros((len(POSITIONS), *SHAPE), bool))
    assert not stamps.any()
