"""Moduli that are constant, or bounded, minimise what they claim to; phases are free."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels.amplitude_codes import COMPLEX, COMPLEX_CONSTANT, CONSTANT, SIGNED
from track_before_detect.kernels.fit import constant_modulus
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.solvers.fit import bounded_moduli
from track_before_detect.solvers.fit.amplitude_fit import fit_amplitudes, objective

MODEL = AMPLITUDE_MODELS[COMPLEX_CONSTANT]


def complex_normal(generator, shape):
    return (generator.standard_normal(shape) + 1j * generator.standard_normal(shape)) / 2**0.5


def problem(seed, n_paths=6, n_frames=8, spread=1.0, masked=False):
    """Return h, G, courses and half the energy of neighbours, some nearly alike."""
    generator = np.random.default_rng(seed)
    places = generator.choice([17.0, 22.0], n_paths) + generator.normal(0, spread, n_paths)
    columns = np.exp(-(np.arange(40.0)[:, None] - places)**2 / 8)
    columns = np.repeat((columns / np.linalg.norm(columns, axis=0))[None], n_frames, axis=0)
    # Far from constant, so that bounds are not in force in every frame.
    x = np.exp(2j * np.pi * generator.random((2, n_frames, 1)))
    x *= generator.uniform(2, 12, x.shape)
    data = x[0] * columns[..., 0] + x[1] * columns[..., 1]
    data += complex_normal(generator, data.shape)
    envelopes = np.ones((n_paths, n_frames))
    if masked:
        columns[1, :, 2] = 0
        envelopes = generator.uniform(0.3, 1, envelopes.shape)
        envelopes[2, 1] = 0
    envelopes /= np.linalg.norm(envelopes, axis=1, keepdims=True)
    matched = np.ascontiguousarray(np.einsum('tip,ti->pt', columns, data))
    gram = np.ascontiguousarray(np.einsum('tip,tiq->pqt', columns, columns))
    return matched, gram, envelopes, 0.5 * np.vdot(data, data).real


@pytest.mark.parametrize('weight', [0.0, 0.1, 1.0, 3.0])
def test_clipped_moduli_are_those_of_the_slow_way(weight):
    generator = np.random.default_rng(1)
    rows, envelopes = complex_normal(generator, (20, 7)), generator.uniform(0.2, 1, (20, 7))
    rows[:, 2] = envelopes[:, 2] = 0
    envelopes /= np.linalg.norm(envelopes, axis=1, keepdims=True)
    expected = naive.clipped(rows, envelopes, np.full(20, weight))
    for row, envelope, wanted in zip(rows.copy(), envelopes, expected, strict=True):
        largest = constant_modulus.clip_moduli(row, envelope, weight)
        np.testing.assert_allclose(row, wanted, atol=1e-13)
        reached = np.max(np.abs(row) / np.where(envelope > 0, envelope, np.inf))
        # Unless nothing is cut off, a bound in force is reached.
        assert largest == pytest.approx(reached, abs=1e-12)


def test_one_modulus_beats_all_others():
    generator = np.random.default_rng(2)
    seen, envelope = 3 * complex_normal(generator, 6), generator.uniform(0.2, 1, 6)
    envelope /= np.linalg.norm(envelope)
    best = seen.copy()
    alpha = constant_modulus.give_one_modulus(best, envelope, 1.5)
    np.testing.assert_allclose(np.abs(best), alpha * envelope, atol=1e-13)
    lowest = 0.5 * np.linalg.norm(best - seen)**2 + 1.5 * alpha
    for _ in range(2000):
        other = alpha * generator.uniform(0, 2)
        x = other * envelope * np.exp(1j * (np.angle(seen) + generator.normal(0, 1, 6)))
        assert 0.5 * np.linalg.norm(x - seen)**2 + 1.5 * other >= lowest - 1e-12


def test_phases_and_one_modulus_are_the_numbers_of_a_path():
    assert MODEL.n_numbers(9) == 10
    others = [AMPLITUDE_MODELS[code].n_numbers(9) for code in (SIGNED, CONSTANT, COMPLEX)]
    assert others == [9, 1, 18]


@pytest.mark.parametrize('t', [0.0, 0.3, 0.9])
@pytest.mark.parametrize('eta', [5.9, 6.1])
def test_a_lone_path_is_worth_adding_above_its_weight_at_every_t(t, eta):
    seen = complex_normal(np.random.default_rng(3), (1, 9))
    envelope = np.full((1, 9), 1 / 3)
    seen *= eta / MODEL.statistic(seen[0], envelope[0])
    one, weights = np.ones((1, 1, 9)), np.array([6.0])
    energy = 0.5 * np.vdot(seen, seen).real
    x, converged = fit_amplitudes(np.zeros_like(seen), seen, one, weights, t, MODEL, energy, 1e-9,
                                  envelope)
    assert converged
    lowered = -objective(x, seen, one, weights, t, MODEL.norms(x, envelope))
    expected = 0.5 * (eta - 6 * t)**2 - 0.5 * (1 - t)**2 * 36
    assert lowered == pytest.approx(expected, abs=1e-9)
    assert (lowered > 0) == (eta > 6)


@pytest.mark.parametrize('masked', [False, True])
@pytest.mark.parametrize('spread', [0.02, 1.0])
def test_bounded_moduli_meet_the_optimality_conditions(spread, masked):
    matched, gram, envelopes, energy = problem(4, spread=spread, masked=masked)
    weights = np.linspace(2, 3, len(matched))
    x, converged = fit_amplitudes(np.zeros_like(matched), matched, gram, weights, 1.0, MODEL,
                                  energy, 0.0, envelopes)
    assert converged
    slack = matched - np.einsum('pqt,qt->pt', gram, x)
    statistics = np.array([MODEL.statistic(*pair) for pair in zip(slack, envelopes, strict=True)])
    assert (statistics <= weights * (1 + 1e-6)).all()
    used = x.any(axis=1)
    assert 0 < used.sum() < len(used)
    np.testing.assert_allclose(statistics[used], weights[used], rtol=1e-6)
    # What is left where a modulus is below its bound would be explained.
    norms = MODEL.norms(x, envelopes)
    below = (np.abs(x) < 0.999 * norms[:, None] * envelopes) & (envelopes > 0)
    assert below[used].any()
    assert np.abs(slack[used][below[used]]).max() < 1e-3


def test_descent_and_interior_points_reach_the_same_optimum():
    matched, gram, envelopes, energy = problem(5, masked=True)
    weights = np.full(len(matched), 5.5)
    x, norms = np.zeros_like(matched), np.empty(len(matched))
    left = constant_modulus.descend(x, norms, matched, gram, envelopes, weights, True, energy,
                                    1e-6, 20000)
    assert left <= 1e-6
    np.testing.assert_allclose(norms, MODEL.norms(x, envelopes), atol=1e-12)
    other, gap = bounded_moduli.solve(matched, gram, envelopes, weights, energy, 1e-6)
    assert gap <= 1e-6
    one, two = (objective(found, matched, gram, weights, 1.0, MODEL.norms(found, envelopes))
                for found in (x, other))
    assert one == pytest.approx(two, abs=2e-6)


@pytest.mark.parametrize('t', [0.0, 0.5])
def test_descent_over_constant_moduli_ends_where_no_small_change_helps(t):
    matched, gram, envelopes, energy = problem(6, n_paths=3, masked=True)
    weights = np.full(len(matched), 5.5)
    before, generator = np.inf, np.random.default_rng(7)
    x = np.zeros_like(matched)
    for _ in range(20):
        constant_modulus.descend(x, np.empty(len(x)), matched, gram, envelopes, t * weights, False,
                                 energy, 0.0, 1)
        reached = objective(x, matched, gram, weights, t, MODEL.norms(x, envelopes))
        assert reached <= before + 1e-9
        before = reached
    x, converged = fit_amplitudes(x, matched, gram, weights, t, MODEL, energy, 1e-9, envelopes)
    assert converged
    norms = MODEL.norms(x, envelopes)
    np.testing.assert_allclose(np.abs(x), norms[:, None] * envelopes, atol=1e-12)
    lowest = objective(x, matched, gram, t * weights, 1.0, norms)
    for size in 10.0**generator.uniform(-5, -1, 300):
        others = np.maximum(norms + size * generator.standard_normal(len(norms)), 0)
        phases = np.angle(x) + size * generator.standard_normal(x.shape)
        changed = others[:, None] * envelopes * np.exp(1j * phases)
        assert objective(changed, matched, gram, t * weights, 1.0, others) >= lowest - 1e-7
