"""Search, screening and certificate agree with every path, one by one, for each model."""

import numpy as np
import pytest

from enumeration import EveryPath
import naive
from track_before_detect.models.amplitudes import amplitude_model
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.solvers.convex.pursuit import pursue, PursuitSettings
from track_before_detect.solvers.fit.working_set import WorkingSet
from track_before_detect.solvers.given_paths.fit_paths import fit_paths
from track_before_detect.solvers.refine.refinement import Refiner
from track_before_detect.solvers.refine.target_model import TargetModel
from track_before_detect.solvers.search import viterbi_table as path_table
from track_before_detect.solvers.search.path_search import path_search

T, SHAPE = 5, (6, 8)
STAMPS = np.arange(float(T))
NO_WEIGHTS = np.zeros((0, 0, 0), np.float32)
THRESHOLD = 3.0
KINDS = ['non-negative', 'signed', 'complex', 'non-negative constant', 'signed constant',
         'complex constant']
NOISES = ['white', 'variance', 'mask']
PSFS = {'gaussian': GaussianPsf(2.0), 'integrated': GaussianPsf(2.0, integrated=True)}


class StayingRefiner:
    """Leaves every path on the grid, so that the enumerated paths are all there are."""

    def refine(self, frames, positions, cost, threshold, t_convex):
        """Find none better."""
        return


class Scene:
    """Targets, noise, and both ways to search them."""

    def __init__(self, kind, noise, psf='gaussian', seed=0):
        name, _, constant = kind.partition(' ')
        self.model = amplitude_model(name, constant or 'fluctuating')
        self.graph = build_state_graph(STAMPS, step_px=1.0, max_speed=0.7, max_acceleration=0.4,
                                       turn_cost=self.model.turn_cost)
        assert self.graph.n_segments == 2 and self.graph.n_velocities == 5
        self.psf = PSFS[psf]
        generator = np.random.default_rng([seed, KINDS.index(kind), NOISES.index(noise)])
        self.weights = None
        if noise == 'variance':
            self.weights = generator.uniform(0.3, 1.5, (T, *SHAPE)).astype(np.float32)
        elif noise == 'mask':
            valid = generator.random((T, *SHAPE)) > 0.2
            valid[1, :, :5] = False
            valid[2] = False
            self.weights = valid.astype(np.float32)
        self.every = EveryPath(list(naive.every_path(self.graph, SHAPE)), self.psf, kind, SHAPE,
                               T, self.weights)
        x = np.zeros((len(self.every.costs), 1 if self.every.constant else T))
        for path in generator.choice(len(x), 3, replace=False):
            x[path] = generator.uniform(4, 9, x.shape[1] if not self.every.one_modulus else 1)
            if name == 'signed':
                x[path] *= generator.choice([-1, 1], x.shape[1])
        noise = generator.standard_normal((T, *SHAPE))
        if name == 'complex':
            x = x * np.exp(2j * np.pi * generator.random(x.shape))
            noise = (noise + 1j * generator.standard_normal(noise.shape)) / np.sqrt(2)
        frames = self.every.picture(x).reshape(noise.shape) + noise
        if self.weights is not None:
            frames[np.broadcast_to(self.weights, frames.shape) == 0] = 0
        self.frames = frames.astype(np.complex64 if name == 'complex' else np.float32)

    def search(self):
        search = path_search(self.graph, self.psf, SHAPE, self.model)
        search.set_weights(self.weights)
        return search

    def path_set(self):
        weights = NO_WEIGHTS if self.weights is None else self.weights
        return WorkingSet(self.frames.copy(), weights, self.psf, THRESHOLD, self.model)

    def refiner(self):
        weights = NO_WEIGHTS if self.weights is None else self.weights
        return Refiner(TargetModel(self.graph, self.psf, STAMPS, weights, self.model))


CASES = [(kind, noise) for kind in KINDS for noise in NOISES]


@pytest.mark.parametrize('psf', PSFS)
@pytest.mark.parametrize(('kind', 'noise'), CASES)
def test_best_path_is_that_of_all_paths_whatever_was_taken_off(monkeypatch, kind, noise, psf):
    # Only what may pass is computed anew, even where filling the table would be quicker.
    monkeypatch.setattr(path_table, 'COST_OF_UPDATE', 0.0)
    scene = Scene(kind, noise, psf)
    search, paths = scene.search(), scene.path_set()
    bound = scene.model.value(THRESHOLD)
    for _ in range(5):
        values = scene.every.values(paths.residual)
        largest, found = search.best_paths(paths.residual, bound, 1.0, 100)
        if values.max() > bound:
            assert largest == pytest.approx(values.max(), rel=1e-4)
            assert found[0].value == largest
        else:
            assert largest <= bound
        assert bool(found) == (values.max() > bound)
        for path in found:
            [same] = np.flatnonzero((scene.every.positions == path.positions).all(axis=(1, 2)))
            assert path.value == pytest.approx(values[same], rel=1e-4)
            assert path.cost == scene.every.costs[same]
        if not found:
            return
        paths.add(found[0].positions, found[0].cost)
        _, amplitudes, _ = paths.fitted(np.arange(len(paths)), 0.0)
        paths.assign(np.arange(len(paths)), amplitudes)


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize(('kind', 'noise'), CASES)
def test_convex_solution_on_the_grid_is_the_optimum_over_all_paths(kind, noise, seed):
    scene = Scene(kind, noise, seed=seed)
    result = pursue(scene.search(), StayingRefiner(), scene.path_set(), 1.0,
                    PursuitSettings((1.0,)))
    assert result.status == 'converged' and len(result.paths) > 0
    weights = scene.every.weights_of(THRESHOLD)
    objective, below = scene.every.optimum(scene.frames.astype(complex if scene.model.is_complex
                                                               else float), weights, 1e-7)
    reached = result.history[-1].objective
    assert reached == pytest.approx(objective, rel=1e-5)
    assert -1e-6 * objective <= reached - objective <= result.gap + 1e-6 * objective
    assert result.gap <= 1e-5 * objective
    left = scene.every.statistics(result.paths.residual) / weights
    assert left.max() <= 1 + 1e-4
    # Paths with amplitudes meet their condition with equality.
    for positions in result.paths.positions:
        [used] = np.flatnonzero((scene.every.positions == positions).all(axis=(1, 2)))
        assert left[used] == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize('tolerance', [0.0, 0.3])
@pytest.mark.parametrize(('kind', 'noise'), CASES)
def test_gap_of_a_refined_solution_is_no_less_than_the_distance_to_the_optimum(
        kind, noise, tolerance):
    scene = Scene(kind, noise, seed=7)
    result = pursue(scene.search(), scene.refiner(), scene.path_set(), 1.0,
                    PursuitSettings((1.0,), tolerance=max(tolerance, 1e-6)))
    # Positions off the grid that the pursuit found are among the paths from then on.
    every = [*zip(scene.every.positions, scene.every.costs, strict=True),
             *zip(result.paths.positions, result.paths.costs, strict=True)]
    everything = EveryPath(every, scene.psf, kind, SHAPE, T, scene.weights)
    weights = everything.weights_of(THRESHOLD)
    np.testing.assert_allclose(weights[len(scene.every.costs):], result.paths.penalties)
    objective, _ = everything.optimum(scene.frames.astype(complex if scene.model.is_complex
                                                          else float), weights, 1e-6)
    assert 0 <= result.history[-1].objective - objective + 2e-6 * objective
    assert result.history[-1].objective - objective <= result.gap + 2e-6 * objective
    left = everything.statistics(result.paths.residual) / weights
    assert left.max() <= 1 + max(tolerance, 1e-6) + 1e-4
    if not tolerance:
        assert result.gap <= 1e-5 * objective


@pytest.mark.parametrize('kind', ['non-negative', 'signed', 'complex'])
def test_weighted_frames_reach_the_optimum_over_all_paths(kind):
    # Weights of the frames of each path (the diagonal W) are columns divided by them.
    scene = Scene(kind, 'white', seed=3)
    own = np.random.default_rng(5).uniform(0.6, 1.6, (len(scene.every.costs), T))
    fit = fit_paths(scene.frames, scene.every.positions, psf=scene.psf, lam=THRESHOLD,
                    amplitudes=kind, weights=own, tol=1e-6)
    objective, _ = scene.every.weighted(own).optimum(
        scene.frames.astype(complex if kind == 'complex' else float),
        np.full(len(own), THRESHOLD), 1e-6)
    assert fit.status == 'converged'
    assert fit.objective == pytest.approx(objective, rel=3e-6)
    assert fit.objective - objective <= fit.gap + 1e-6 * objective
