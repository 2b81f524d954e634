"""Shrinkage minimises what it claims to; descent reaches the optimality conditions."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels.amplitude_codes import CONSTANT, NON_NEGATIVE, SIGNED
from track_before_detect.kernels.fit import group_lasso
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.solvers.fit.amplitude_fit import fit_amplitudes


def shrunk(row, weight, code):
    """Shrink the amplitudes of one path, as the sweeps of the solver do; no weight is t = 0."""
    amplitudes, converged = fit_amplitudes(
        np.zeros((1, len(row))), row[None], np.ones((1, 1, len(row))), np.array([weight or 1.0]),
        1.0 if weight else 0.0, AMPLITUDE_MODELS[code], 0.5 * float(row @ row), 0.0)
    assert converged
    return amplitudes[0]


@pytest.mark.parametrize('weight', [0.0, 0.7, 2.0, 9.0])
def test_shrink_equals_closed_form(weight):
    row = np.random.default_rng(1).standard_normal(6) * 2
    expected = naive.shrink(row, weight)
    np.testing.assert_allclose(shrunk(row, weight, NON_NEGATIVE), expected, atol=1e-12)


@pytest.mark.parametrize('weight', [0.3, 1.4])
def test_shrink_beats_a_grid_search(weight):
    target = np.array([1.3, -0.4])
    best = shrunk(target, weight, NON_NEGATIVE)

    def value(x, y):
        return (0.5 * ((x - target[0])**2 + (y - target[1])**2)
                + weight * np.hypot(x, y))

    grid = np.linspace(0, 2, 401)
    everywhere = value(*np.meshgrid(grid, grid))
    assert value(*best) <= everywhere.min() + 1e-12


@pytest.mark.parametrize(('code', 'allowed'), [
    (SIGNED, lambda x, y: True), (CONSTANT, lambda x, y: x == y)])
def test_shrink_of_other_models_beats_a_grid_search(code, allowed):
    target = np.array([1.3, -0.45])
    best = shrunk(target, 0.3, code)
    assert allowed(*best)

    def value(x, y):
        return 0.5 * ((x - target[0])**2 + (y - target[1])**2) + 0.3 * np.hypot(x, y)

    grid = np.linspace(-2, 2, 401)
    points = np.meshgrid(grid, grid) if code == SIGNED else (grid[200:], grid[200:])
    assert value(*best) <= value(*points).min() + 1e-12


@pytest.mark.parametrize('weight', [0.3, 2.0, 4.9])
@pytest.mark.parametrize('seed', range(4))
def test_the_norm_found_on_the_line_is_that_of_the_solution(weight, seed):
    generator = np.random.default_rng(seed)
    row = generator.standard_normal((2, 5))
    diagonal = 10**generator.uniform(-3, 3, 5)
    row[:, 2] = diagonal[2] = 0
    row *= 5 / np.linalg.norm(row)
    size = group_lasso.shrunk_norm(row, diagonal, weight)
    solution = row / (diagonal + weight / size)
    assert np.linalg.norm(solution) == pytest.approx(size, rel=1e-12)
    # The gradient of the objective vanishes there.
    np.testing.assert_allclose(diagonal * solution + weight * solution / size, row, atol=1e-12)


def test_equal_norms_give_the_closed_form():
    row = np.random.default_rng(3).standard_normal((1, 7)) * 4
    size = group_lasso.shrunk_norm(row, np.full(7, 2.0), 1.5)
    assert size == pytest.approx((np.linalg.norm(row) - 1.5) / 2.0, rel=1e-14)
