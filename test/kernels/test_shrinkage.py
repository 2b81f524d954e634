"""Shrinkage minimises what it claims to; descent reaches the optimality conditions."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels import shrinkage
from track_before_detect.models.amplitudes import CONSTANT, NON_NEGATIVE, SIGNED


@pytest.mark.parametrize('weight', [0.0, 0.7, 2.0, 9.0])
def test_shrink_equals_closed_form(weight):
    row = np.random.default_rng(1).standard_normal(6) * 2
    expected = naive.shrink(row, weight)
    shrinkage.shrink(row, weight, NON_NEGATIVE)
    np.testing.assert_allclose(row, expected, atol=1e-12)


@pytest.mark.parametrize('weight', [0.3, 1.4])
def test_shrink_beats_a_grid_search(weight):
    target = np.array([1.3, -0.4])
    best = target.copy()
    shrinkage.shrink(best, weight, NON_NEGATIVE)

    def value(x, y):
        return (0.5 * ((x - target[0])**2 + (y - target[1])**2)
                + weight * np.hypot(x, y))

    grid = np.linspace(0, 2, 401)
    everywhere = value(*np.meshgrid(grid, grid))
    assert value(*best) <= everywhere.min() + 1e-12


ALL = np.ones((5, 5), bool)


@pytest.mark.parametrize(('code', 'allowed'), [
    (SIGNED, lambda x, y: True), (CONSTANT, lambda x, y: x == y)])
def test_shrink_of_other_models_beats_a_grid_search(code, allowed):
    target = np.array([1.3, -0.45])
    best = target.copy()
    shrinkage.shrink(best, 0.3, code)
    assert allowed(*best)

    def value(x, y):
        return 0.5 * ((x - target[0])**2 + (y - target[1])**2) + 0.3 * np.hypot(x, y)

    grid = np.linspace(-2, 2, 401)
    points = np.meshgrid(grid, grid) if code == SIGNED else (grid[200:], grid[200:])
    assert value(*best) <= value(*points).min() + 1e-12


def problem(seed, n_paths=5, n_frames=4):
    """Return matched filter and overlaps of random stamps, neighbours nearly alike."""
    generator = np.random.default_rng(seed)
    columns = generator.random((n_frames, 30, n_paths)) + 0.5 * generator.random((30, 1))
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    data = columns @ np.array([4.0, 0, 3, 0, 0]) + generator.standard_normal((n_frames, 30))
    matched = np.einsum('tip,ti->pt', columns, data)
    gram = np.einsum('tip,tiq->pqt', columns, columns)
    return np.ascontiguousarray(matched), np.ascontiguousarray(gram)


@pytest.mark.parametrize('t', [1.0, 0.4, 0.0])
@pytest.mark.parametrize('seed', range(4))
def test_descent_reaches_the_optimality_conditions(seed, t):
    matched, gram = problem(seed)
    weights = np.array([3.0, 3.1, 3.0, 3.5, 3.0])
    amplitudes = np.zeros(matched.shape)
    sweeps = shrinkage.descend(amplitudes, matched, gram, ALL, weights, t, NON_NEGATIVE, 1e-12,
                               200000)
    assert sweeps <= 200000
    gradient = np.einsum('pqt,qt->pt', gram, amplitudes) - matched
    for row, slope, weight in zip(amplitudes, gradient, weights, strict=True):
        norm = np.linalg.norm(row)
        if norm == 0:
            assert np.linalg.norm(np.maximum(-slope, 0)) <= t * weight + 1e-6
        else:
            total = slope + t * weight * row / norm
            assert np.abs(total[row > 0]).max() < 1e-6
            assert (total[row == 0] > -1e-6).all()


def test_each_sweep_lowers_the_objective():
    matched, gram = problem(7)
    weights = np.full(5, 3.0)
    amplitudes = np.zeros(matched.shape)
    values = [naive.convex_objective(amplitudes, matched, gram, weights, 1.0)]
    for _ in range(30):
        shrinkage.descend(amplitudes, matched, gram, ALL, weights, 1.0, NON_NEGATIVE, 0.0, 1)
        values.append(naive.convex_objective(amplitudes, matched, gram, weights, 1.0))
    assert (np.diff(values) <= 1e-10).all()
    assert values[-1] < values[0]
