"""Amplitudes of overlapping paths reach the optimum, however alike the paths are."""

import numpy as np
import pytest
from scipy.optimize import nnls

import naive
from track_before_detect.kernels.amplitude_codes import CONSTANT, NON_NEGATIVE, SIGNED
from track_before_detect.kernels.fit import group_lasso
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.solvers.fit.amplitude_fit import (
    fit_amplitudes,
    MOST_FOR_NEWTON,
    objective,
)
from track_before_detect.solvers.watch import Watch


def problem(seed, n_paths=6, n_frames=4, spread=0.3, sigma=2.0, amplitude=9.0, masked=False):
    """Return columns (T, pixels, P) of neighbours nearly alike, and data of two of them."""
    generator = np.random.default_rng(seed)
    pixels = np.arange(40.0)
    places = generator.choice([17.0, 22.0], n_paths) + generator.normal(0, spread, n_paths)
    columns = np.exp(-(pixels[:, None] - places)**2 / (2 * sigma**2))
    columns = np.repeat((columns / np.linalg.norm(columns, axis=0))[None], n_frames, axis=0)
    if masked:
        columns[1, :, 2] = 0
    data = amplitude * (columns[:, :, 0] + columns[:, :, 1])
    return columns, data + generator.standard_normal((n_frames, 40))


def in_numbers(columns, data):
    matched = np.einsum('tip,ti->pt', columns, data)
    gram = np.einsum('tip,tiq->pqt', columns, columns)
    return np.ascontiguousarray(matched), np.ascontiguousarray(gram), 0.5 * np.sum(data**2)


def fit(columns, data, t, code, weights, start=None):
    matched, gram, energy = in_numbers(columns, data)
    amplitudes, converged = fit_amplitudes(
        np.zeros(matched.shape) if start is None else start, matched, gram, weights, t,
        AMPLITUDE_MODELS[code], energy, 1e-10)
    assert converged
    used = np.any(amplitudes, axis=1)
    assert objective(amplitudes, matched, gram, weights, t) == pytest.approx(
        naive.convex_objective(amplitudes, matched, gram, weights, t)
        + 0.5 * (1 - t)**2 * np.sum(weights[used]**2), abs=1e-9 * energy)
    slack = matched - np.einsum('pqt,qt->pt', gram, amplitudes)
    return amplitudes, slack


WEIGHTS = np.array([3.0, 3.1, 3.0, 3.5, 3.0, 4.0])


@pytest.mark.parametrize('masked', [False, True])
@pytest.mark.parametrize('code', [NON_NEGATIVE, SIGNED])
@pytest.mark.parametrize('t', [1.0, 0.4, 0.05])
@pytest.mark.parametrize('seed', range(5))
def test_amplitudes_meet_the_optimality_conditions(seed, t, code, masked):
    amplitudes, slack = fit(*problem(seed, masked=masked), t, code, WEIGHTS)
    if code == NON_NEGATIVE:
        assert (amplitudes >= 0).all()
    assert amplitudes.any()
    for row, left, weight in zip(amplitudes, slack, WEIGHTS, strict=True):
        norm = np.linalg.norm(row)
        if code == NON_NEGATIVE:
            left = np.where(row > 0, left, np.maximum(left, 0))
        assert np.linalg.norm(left) <= t * weight + 1e-4
        if norm > 1e-3:
            assert np.abs(left - t * weight * row / norm).max() < 1e-3


@pytest.mark.parametrize('code', [NON_NEGATIVE, SIGNED, CONSTANT])
@pytest.mark.parametrize('t', [1.0, 0.4, 0.0])
def test_no_change_of_the_amplitudes_lowers_the_objective(code, t):
    columns, data = problem(11, masked=True)
    best, _ = fit(columns, data, t, code, WEIGHTS)
    matched, gram, _ = in_numbers(columns, data)
    lowest = naive.convex_objective(best, matched, gram, WEIGHTS, t)
    generator = np.random.default_rng(1)
    for size in 10.0**generator.uniform(-6, 1, 300):
        other = best + size * generator.standard_normal(best.shape)
        if code == NON_NEGATIVE:
            other = np.maximum(other, 0)
        if code == CONSTANT:
            other[:] = np.maximum(other.mean(axis=1, keepdims=True), 0)
        assert naive.convex_objective(other, matched, gram, WEIGHTS, t) >= lowest - 1e-9


@pytest.mark.parametrize('seed', range(5))
def test_without_shrinkage_each_frame_is_non_negative_least_squares(seed):
    columns, data = problem(seed, spread=1.0, masked=True)
    amplitudes, _ = fit(columns, data, 0.0, NON_NEGATIVE, WEIGHTS)
    for k, (matrix, target) in enumerate(zip(columns, data, strict=True)):
        expected, residual = nnls(matrix, target)
        assert np.linalg.norm(target - matrix @ amplitudes[:, k]) == pytest.approx(
            residual, rel=1e-9)
        if np.linalg.cond(matrix[:, matrix.any(axis=0)]) < 1e4:
            np.testing.assert_allclose(amplitudes[:, k], expected, atol=1e-4)


def test_without_shrinkage_signed_amplitudes_are_least_squares():
    columns, data = problem(2, spread=1.0)
    _, slack = fit(columns, data, 0.0, SIGNED, WEIGHTS)
    assert np.abs(slack).max() < 1e-5


@pytest.mark.parametrize('code', [NON_NEGATIVE, SIGNED, CONSTANT])
@pytest.mark.parametrize('t', [1.0, 0.3, 0.0])
def test_the_start_does_not_matter(code, t):
    columns, data = problem(4, spread=1.0)
    matched, gram, _ = in_numbers(columns, data)
    cold, _ = fit(columns, data, t, code, WEIGHTS)
    start = np.abs(np.random.default_rng(0).standard_normal(cold.shape)) * 5
    if code == CONSTANT:
        start[:] = start[:, :1]
    warm, _ = fit(columns, data, t, code, WEIGHTS, start)
    one, other = (naive.convex_objective(x, matched, gram, WEIGHTS, t) for x in (cold, warm))
    assert one == pytest.approx(other, abs=1e-8)


@pytest.mark.parametrize('non_negative', [True, False])
@pytest.mark.parametrize('n_frames', [1, 2, 20])
@pytest.mark.parametrize('spread', [0.01, 0.3, 2.0])
def test_twelve_near_duplicates_are_solved_in_a_few_rounds(n_frames, spread, non_negative):
    for seed in range(3):
        matched, gram, energy = in_numbers(*problem(
            seed, 12, n_frames, spread, sigma=3.0, amplitude=30.0))
        matched, gram = matched[:, None] / 4, gram / 16
        amplitudes = np.zeros_like(matched)
        gap, rounds = group_lasso.solve(amplitudes, matched, gram, np.empty_like(matched), 1.0,
                                        non_negative, energy, 1e-11 * energy, 100)
        assert gap <= 1e-11 * energy
        assert rounds <= 15


def test_two_equal_paths_share_what_one_has():
    columns, data = problem(3, n_paths=2)
    columns[:, :, 1] = columns[:, :, 0]
    for t in (1.0, 0.0):
        both, _ = fit(columns, data, t, NON_NEGATIVE, np.full(2, 3.0))
        one, _ = fit(columns[:, :, :1], data, t, NON_NEGATIVE, np.full(1, 3.0))
        np.testing.assert_allclose(both.sum(axis=0), one[0], atol=1e-4)


@pytest.mark.parametrize('non_negative', [True, False])
def test_many_paths_reach_the_optimum_with_a_limited_time_too(non_negative):
    columns, data = problem(1, n_paths=MOST_FOR_NEWTON + 10, spread=6.0, sigma=0.6)
    matched, gram, energy = in_numbers(columns, data)
    weights = np.full(len(matched), 3.0)
    model = AMPLITUDE_MODELS[NON_NEGATIVE if non_negative else SIGNED]
    values = []
    for watch in (None, Watch(60.0)):
        amplitudes, converged = fit_amplitudes(np.zeros(matched.shape), matched, gram, weights,
                                               1.0, model, energy, 1e-3, watch=watch)
        assert converged and amplitudes.any()
        values.append(objective(amplitudes, matched, gram, weights, 1.0))
    assert values[0] == pytest.approx(values[1], abs=1e-3)


def test_many_paths_are_left_when_the_time_is_up():
    columns, data = problem(1, n_paths=MOST_FOR_NEWTON + 10, spread=6.0, sigma=3.0)
    matched, gram, energy = in_numbers(columns, data)
    _, converged = fit_amplitudes(
        np.zeros(matched.shape), matched, gram, np.full(len(matched), 3.0), 1.0,
        AMPLITUDE_MODELS[NON_NEGATIVE], energy, 1e-12, watch=Watch(1e-9))
    assert not converged
