"""The pursuit descends, ends with a certificate, and recovers what is there."""

import numpy as np
import pytest

from track_before_detect.kernels.amplitude_codes import CONSTANT, NON_NEGATIVE, SIGNED
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.solvers.convex import pursuit
from track_before_detect.solvers.convex.certificate import duality_gap
from track_before_detect.solvers.convex.pursuit import (
    keep_what_passes,
    pursue,
    PursuitSettings,
)
from track_before_detect.solvers.fit.working_set import WorkingSet
from track_before_detect.solvers.refine.refinement import Refiner
from track_before_detect.solvers.refine.target_model import TargetModel
from track_before_detect.solvers.search.path_search import path_search

MODEL = AMPLITUDE_MODELS[NON_NEGATIVE]
NO_MASK = np.zeros((0, 0, 0), bool)
T, H, W = 8, 24, 30
STAMPS = np.arange(float(T))


def straight(x, y, v_x, v_y):
    return np.stack([x + v_x * STAMPS, y + v_y * STAMPS], axis=1)


SCENES = {
    'far apart': [(straight(5, 5, 0.5, 0.3), 4.0), (straight(22, 18, -0.4, 0.1), 3.0)],
    'close': [(straight(8, 10, 0.6, 0.0), 6.0), (straight(8, 13, 0.6, 0.0), 6.0)],
    'crossing': [(straight(6, 8, 0.9, 0.4), 4.0), (straight(13, 8, -0.9, 0.4), 4.0)],
    'bright': [(straight(8, 10, 0.6, 0.2), 40.0)],
    'empty': [],
}


def scene(name, seed):
    frames = np.random.default_rng(seed).standard_normal((T, H, W)).astype(np.float32)
    paths = WorkingSet(np.zeros((T, H, W), np.float32), NO_MASK, GaussianPsf(1.0), 1.0, MODEL)
    for positions, amplitude in SCENES[name]:
        paths.add(positions, 0.0)
        paths.assign(np.array([len(paths) - 1]), np.full((1, T), amplitude))
    return frames - paths.residual


def solve(frames, continuation, threshold=6.5, mask=None, model=MODEL, **settings):
    psf = GaussianPsf(1.0)
    graph = build_state_graph(STAMPS, step_px=0.5, max_speed=1.0, max_acceleration=0.1,
                              turn_cost=model.turn_cost)
    search = path_search(graph, psf, (H, W), model)
    search.set_weights(mask)
    valid = NO_MASK if mask is None else mask
    paths = WorkingSet(frames, valid, psf, threshold, model)
    result = pursue(search, Refiner(TargetModel(graph, psf, STAMPS, valid, model)), paths, 3.0,
                    PursuitSettings(continuation, **settings))
    return result, search


@pytest.mark.parametrize('name', SCENES)
@pytest.mark.parametrize('seed', [1, 2])
@pytest.mark.parametrize('continuation', [(1.0,), (0.0,), (1.0, 0.6, 0.2, 0.0)])
def test_objective_never_rises_within_a_stage(name, seed, continuation):
    result, _ = solve(scene(name, seed), continuation, tolerance=1e-3)
    for t in continuation:
        values = [step.objective for step in result.history if step.t == t]
        assert values
        assert (np.diff(values) <= 1e-6).all()


@pytest.mark.parametrize('name', SCENES)
@pytest.mark.parametrize('continuation', [(1.0,), (0.0,), (1.0, 0.6, 0.2, 0.0)])
def test_converged_means_that_no_path_passes_the_threshold(name, continuation):
    frames = scene(name, 5)
    result, search = solve(frames, continuation, tolerance=1e-3)
    assert result.status == 'converged'
    left = np.sqrt(max(search.best_value(result.paths.residual), 0))
    if continuation == (1.0,):
        assert left <= 6.5 * (1 + 1e-3) * (1 + 1e-5)
    assert result.history[-1].violation == pytest.approx(left / 6.5 - 1, abs=1e-4)


def test_history_ends_with_the_state_that_is_left_at_the_limit_of_rounds():
    result, _ = solve(scene('crossing', 7), (0.0,), most_rounds=1)
    assert result.status == 'iteration_limit' and len(result.paths) > 0
    assert result.history[-1].n_paths == len(result.paths)
    assert result.history[-1].objective == pytest.approx(result.paths.objective(0.0))


@pytest.mark.parametrize('name', SCENES)
def test_duality_gap_bounds_what_a_tighter_solution_gains(name):
    frames = scene(name, 6)
    loose, _ = solve(frames, (1.0,), tolerance=0.05)
    tight, _ = solve(frames, (1.0,), tolerance=1e-4)
    loose_value, tight_value = (r.history[-1].objective for r in (loose, tight))
    assert 0 <= loose.gap
    assert loose_value - tight_value <= loose.gap + 1e-4
    assert tight.gap <= 1e-3 * tight_value


@pytest.mark.parametrize('seed', range(6))
def test_a_convex_solution_of_close_pairs_is_certified_to_seven_digits(seed):
    frames = scene('close', seed) + scene('bright', seed)
    result, search = solve(frames, (1.0,))
    assert result.status == 'converged'
    assert 0 <= result.gap <= 1e-6 * result.history[-1].objective
    assert np.sqrt(search.best_value(result.paths.residual)) <= 6.5 * (1 + 1e-5)


def test_duality_gap_of_nothing_is_zero_when_nothing_passes():
    frames = scene('empty', 1)
    paths = WorkingSet(frames, NO_MASK, GaussianPsf(1.0), 50.0, MODEL)
    assert duality_gap(paths, 40.0) == pytest.approx(0, abs=1e-6 * paths.energy)


@pytest.mark.parametrize('name', ['far apart', 'close', 'crossing', 'bright'])
def test_each_target_of_a_scene_is_one_trajectory(name):
    result, _ = solve(scene(name, 3), (1.0, 0.8, 0.6, 0.4, 0.2, 0.0))
    found = result.paths.positions
    assert len(found) == len(SCENES[name])
    for positions, _ in SCENES[name]:
        errors = [np.hypot(*(other - positions).T).mean() for other in found]
        assert min(errors) < 0.8


@pytest.mark.parametrize('speed', [(0.0, 0.0), (0.37, -0.21), (0.81, 0.4)])
def test_noise_free_target_is_recovered_exactly(speed):
    positions = straight(9.3, 12.7, *speed)
    maker = WorkingSet(np.zeros((T, H, W), np.float32), NO_MASK, GaussianPsf(1.0), 1.0, MODEL)
    maker.add(positions, 0.0)
    maker.assign(np.array([0]), np.linspace(8, 12, T)[None])
    result, _ = solve(-maker.residual, (1.0, 0.5, 0.0))
    assert len(result.paths) == 1
    np.testing.assert_allclose(result.paths.positions[0], positions, atol=2e-2)
    np.testing.assert_allclose(result.paths.amplitudes[0], np.linspace(8, 12, T), rtol=1e-3)


def test_nothing_is_found_at_the_largest_statistic_and_something_just_below():
    frames = scene('far apart', 4)
    _, search = solve(frames, (0.0,), threshold=100.0)
    largest = np.sqrt(search.best_value(frames))
    assert len(solve(frames, (1.0,), threshold=largest * 1.0001)[0].paths) == 0
    assert len(solve(frames, (1.0,), threshold=largest * 0.999, tolerance=1e-4)[0].paths) > 0


@pytest.mark.parametrize('seed', range(4))
def test_every_path_of_a_crowd_passes_its_weight(seed):
    generator = np.random.default_rng(seed)
    maker = WorkingSet(np.zeros((T, H, W), np.float32), NO_MASK, GaussianPsf(1.0), 1.0, MODEL)
    for _ in range(25):
        maker.add(straight(*generator.uniform(6, 17, 2), *generator.uniform(-0.5, 0.5, 2)), 0.0)
        maker.assign(np.array([len(maker) - 1]), generator.uniform(2, 9, (1, T)))
    noise = generator.standard_normal((T, H, W)).astype(np.float32)
    result, _ = solve(noise - maker.residual, (1.0, 0.8, 0.6, 0.4, 0.2, 0.0))
    paths = result.paths
    assert len(paths) > 5
    for path in range(len(paths)):
        assert paths.statistic(path) >= paths.penalties[path]


@pytest.mark.parametrize('code', [SIGNED, CONSTANT])
@pytest.mark.parametrize('name', ['far apart', 'crossing'])
def test_other_amplitude_models_find_each_target_once(name, code):
    model = AMPLITUDE_MODELS[code]
    threshold = 8.0 if code == SIGNED else 5.5
    result, _ = solve(scene(name, 3), (1.0, 0.6, 0.2, 0.0), threshold, model=model)
    assert result.status == 'converged'
    assert len(result.paths) == len(SCENES[name])
    for positions, _ in SCENES[name]:
        errors = [np.hypot(*(other - positions).T).mean() for other in result.paths.positions]
        assert min(errors) < 0.8
    if code == CONSTANT:
        assert np.ptp(result.paths.amplitudes, axis=1).max() < 1e-9


def test_negative_target_is_found_only_when_signs_are_free():
    frames = -scene('far apart', 3)
    free, _ = solve(frames, (1.0, 0.5, 0.0), 8.0, model=AMPLITUDE_MODELS[SIGNED])
    assert len(free.paths) == 2 and (free.paths.amplitudes.mean(axis=1) < -2).all()
    assert len(solve(frames, (1.0, 0.5, 0.0), 8.0)[0].paths) == 0


@pytest.mark.parametrize('code', [SIGNED, CONSTANT])
@pytest.mark.parametrize('name', ['close', 'bright', 'empty'])
def test_other_amplitude_models_descend_to_a_certificate(name, code):
    model = AMPLITUDE_MODELS[code]
    result, search = solve(scene(name, 5), (1.0,), 7.0, model=model, tolerance=1e-3)
    assert (np.diff([step.objective for step in result.history]) <= 1e-6).all()
    assert result.status == 'converged'
    assert model.from_value(search.best_value(result.paths.residual)) <= 7.0 * 1.0011
    assert 0 <= result.gap <= 1e-3 * result.history[-1].objective


def test_masked_pixels_do_not_count():
    frames = scene('far apart', 3)
    valid = np.ones(frames.shape, bool)
    valid[:, :, :11] = False
    frames[~valid] = 0
    result, _ = solve(frames, (1.0, 0.5, 0.0), mask=valid)
    assert len(result.paths) == 1
    assert np.abs(result.paths.positions[0] - SCENES['far apart'][1][0]).max() < 1.5


def test_residual_is_frames_less_fit_after_many_changes():
    frames = scene('close', 9)
    result, _ = solve(frames, (1.0, 0.8, 0.6, 0.4, 0.2, 0.0))
    paths = result.paths
    kept = paths.residual.copy()
    paths.refresh()
    np.testing.assert_allclose(kept, paths.residual, atol=1e-4)
    expected = 0.5 * np.sum(paths.residual.astype(float)**2)
    expected += 0.5 * np.sum(paths.penalties**2)
    assert paths.objective(0.0) == pytest.approx(expected, rel=1e-6)


def test_more_paths_than_are_held_are_reported_as_a_limit(monkeypatch):
    monkeypatch.setattr(pursuit, 'MOST_PATHS', 1)
    monkeypatch.setattr(pursuit, 'MOST_NEW_PATHS', 1)
    result, _ = solve(scene('far apart', 3), (1.0, 0.5, 0.0))
    assert result.status == 'iteration_limit'
    assert len(result.paths) == 1


@pytest.mark.parametrize('continuation', [[1.0], [1.0, 0.5, 0.0], [0.0]])
def test_noise_far_above_one_ends_when_the_fits_have_taken_enough(continuation, monkeypatch):
    monkeypatch.setattr(pursuit, 'MOST_WORK', 3e4)
    noise = 5 * np.random.default_rng(3).standard_normal((T, H, W)).astype(np.float32)
    result, _ = solve(noise, continuation)
    assert result.status == 'iteration_limit'
    assert result.paths.amplitudes.any(axis=1).all()
    # What begins before the limit is passed may be several fits of all paths.
    assert 3e4 < result.paths.work < 3e4 + 5 * len(result.paths)**3


def test_path_that_passes_only_off_the_grid_is_found():
    # A quarter of a pixel off on both axes, and slower than the grid by half a step.
    truth = straight(8.25, 10.25, 0.55, 0.0)
    paths = WorkingSet(np.zeros((T, H, W), np.float32), NO_MASK, GaussianPsf(1.0), 1.0, MODEL)
    paths.add(truth, 0.0)
    paths.assign(np.array([0]), np.full((1, T), 6.6 / T**0.5))
    result, search = solve(-paths.residual, (1.0, 0.5, 0.0))
    assert search.best_value(-paths.residual) < 6.5**2
    assert len(result.paths) == 1
    assert np.abs(result.paths.positions[0] - truth).max() < 0.05
    assert result.paths.statistic(0) == pytest.approx(6.6, rel=1e-3)


@pytest.mark.parametrize('name', SCENES)
def test_what_is_kept_of_a_convex_solution_is_one_path_for_each_target(name):
    result, _ = solve(scene(name, 5), (1.0,))
    paths = result.paths
    n_spread = len(paths)
    keep_what_passes(paths)
    assert len(paths) == len(SCENES[name]) <= n_spread
    for path in range(len(paths)):
        assert paths.statistic(path) > paths.penalties[path]
        np.testing.assert_allclose(paths.amplitudes[path], paths.best(path), atol=0.5)
    kept = paths.residual.copy()
    paths.refresh()
    np.testing.assert_allclose(kept, paths.residual, atol=1e-4)
