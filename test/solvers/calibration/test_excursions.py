"""Theory of how many paths of noise pass a level."""

import math

import numpy as np
import pytest
from scipy.stats import binom, chi, norm

from track_before_detect.solvers.calibration.excursions import (
    densities,
    expected_islands,
    mixture,
)

LEVEL = 5.5


@pytest.mark.parametrize('n_numbers', [1, 4, 17])
def test_densities_are_the_derivatives_of_how_often_a_norm_passes(n_numbers):
    steps = LEVEL + 0.01 * np.arange(-4, 5)
    tail = chi(n_numbers).sf(steps)
    found = densities(np.array([[LEVEL]]), np.array([[float(n_numbers)]]))[:, 0, 0]
    assert found[0] == pytest.approx(tail[4], rel=1e-9)
    for j in range(1, 4):
        tail = -np.gradient(tail, steps, edge_order=2)
        assert found[j] == pytest.approx((2 * math.pi)**(-j / 2) * tail[4], rel=2e-3)


def test_statistics_of_positive_amplitudes_pass_as_often_as_those_of_the_frames_that_count():
    lengths = np.array([[9], [4]])
    numbers, chances = mixture(lengths, constant=False, signed=False)
    generator = np.random.default_rng(4)
    squares = np.cumsum(np.maximum(generator.standard_normal((200_000, 9)), 0)**2, axis=1)
    expected = np.sum(chances * chi(numbers).sf(2.5), axis=1)
    assert np.mean(squares[:, [8, 3]] > 2.5**2, axis=0) == pytest.approx(expected, rel=0.05)
    assert chances.sum(axis=1) == pytest.approx(1 - binom.pmf(0, lengths[:, 0], 0.5))
    numbers, chances = mixture(lengths, constant=True, signed=False)
    assert np.sum(chances * chi(numbers).sf(LEVEL), axis=1) == pytest.approx(norm.sf(LEVEL))
    assert mixture(lengths, constant=False, signed=True)[0] == pytest.approx(lengths)


def islands_of(side=30.0, radius=0.5, n_frames=12, signed=False):
    places = np.array([[1.0], [2 * side], [side**2]])
    [found] = expected_islands(
        np.array([LEVEL]), np.array([n_frames]), True, signed, places, radius)
    return found


def test_islands_of_a_still_target_are_those_of_a_field_in_the_plane():
    side = 30.0
    found = islands_of(side, 0.0)
    height = math.exp(-LEVEL**2 / 2)
    expected = (side**2 * LEVEL * height / (2 * math.pi)**1.5 + 2 * side * height / (2 * math.pi)
                + norm.sf(LEVEL))
    assert found == pytest.approx(expected, rel=1e-9)
    assert islands_of(side, 0.0, signed=True) == pytest.approx(2 * found)


def test_islands_grow_with_area_speed_and_frames():
    assert islands_of() < islands_of(side=40.0)
    assert islands_of(radius=0.0) < islands_of(radius=0.1) < islands_of() < islands_of(radius=0.8)
    assert islands_of() < islands_of(n_frames=15)
