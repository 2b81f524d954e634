"""A search that computes little anew gives what a search from the start gives."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

import naive
from track_before_detect.kernels.amplitude_codes import COMPLEX, CONSTANT, NON_NEGATIVE, SIGNED
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.convex.pursuit import pursue, PursuitSettings
from track_before_detect.solvers.fit.working_set import WorkingSet
from track_before_detect.solvers.refine.refinement import Refiner
from track_before_detect.solvers.refine.target_model import TargetModel
from track_before_detect.solvers.search import held_rows
from track_before_detect.solvers.search import viterbi_table as path_table
from track_before_detect.solvers.search.path_search import path_search
from track_before_detect.solvers.search.viterbi_table import table_bytes, ViterbiTable

NO_MASK = np.zeros((0, 0, 0), bool)
GRAPHS = {
    'straight': {'max_speed': 1.0, 'max_acceleration': 0.0},
    'few turns': {'max_speed': 1.0, 'max_acceleration': 0.08},
    'wide turns': {'max_speed': 1.3, 'max_acceleration': 1.5},
    'static': {'max_speed': 0.0, 'max_acceleration': 0.0},
}


def graph_named(name, stamps, turn_cost=3.0):
    return build_state_graph(stamps, step_px=0.5, turn_cost=turn_cost, **GRAPHS[name])


def changed(generator, scores, sign):
    """Return scores that differ in one box of each frame."""
    new = scores.copy()
    y, x = generator.integers(0, scores.shape[1] - 3), generator.integers(0, scores.shape[2] - 3)
    for frame in new:
        box = frame[y:y + generator.integers(1, 9), x:x + generator.integers(1, 9)]
        change = generator.exponential(2.0, box.shape).astype(np.float32)
        box += {'up': change, 'down': -np.minimum(change, box), 'both': change - 2}[sign]
    return new


@pytest.mark.parametrize('name', GRAPHS)
@pytest.mark.parametrize('sign', ['up', 'down', 'both'])
@pytest.mark.parametrize('width', [31, 150])
@pytest.mark.parametrize('n_threads', [1, 2])
@pytest.mark.parametrize('presence', [None, Presence(0.8, 1.5, 2.5)], ids=['full', 'partial'])
def test_changed_scores_give_the_table_of_a_fill(monkeypatch, name, sign, width, n_threads,
                                                 presence):
    # Not even when filling would be quicker.
    monkeypatch.setattr(path_table, 'COST_OF_UPDATE', 0.0)
    generator = np.random.default_rng([len(name), len(sign), width])
    graph = graph_named(name, np.array([0.0, 1, 2, 3, 5, 6, 7, 8, 9]))
    scores = generator.exponential(size=(9, 29, width)).astype(np.float32)
    kept = ViterbiTable(graph, scores.shape[1:], n_threads, presence=presence)
    per_frame = presence.per_frame if presence else 0.0
    for _ in range(6):
        fresh = ViterbiTable(graph, scores.shape[1:], presence=presence)
        filled = fresh.fill(scores, per_frame)
        level = float(np.quantile(fresh.best, generator.choice([0.0, 0.8, 0.99, 1.0])))
        assert kept.update(scores, level, per_frame=per_frame) == filled == fresh.best.max()
        assert (kept.best >= fresh.best).all()
        told = np.maximum(kept.best, fresh.best) > level
        np.testing.assert_array_equal(kept.best[told], fresh.best[told])
        for again, anew in zip(*(table.best_paths(level, 3, 5) for table in (kept, fresh)),
                               strict=True):
            np.testing.assert_equal(again._asdict(), anew._asdict())
        scores = changed(generator, scores, sign)


def test_updated_table_has_the_value_of_the_best_of_every_path(monkeypatch):
    monkeypatch.setattr(path_table, 'COST_OF_UPDATE', 0.0)
    graph = build_state_graph(np.arange(4.0), step_px=1.0, max_speed=0.7, max_acceleration=0.9,
                              turn_cost=0.5)
    assert graph.n_segments > 1 and graph.n_velocities**graph.n_segments < 20000
    generator = np.random.default_rng(2)
    scores = generator.exponential(size=(4, 5, 6)).astype(np.float32)
    table = ViterbiTable(graph, (5, 6))
    for sign in ('down', 'both', 'down', 'up'):
        scores = changed(generator, scores, sign)
        expected, _ = naive.best_path_value(graph, scores)
        assert table.update(scores, 0.5 * expected) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize('name', GRAPHS)
@pytest.mark.parametrize('share', [0.0, 0.6])
@pytest.mark.parametrize('shape', [(29, 31), (60, 150), (1, 40)])
@pytest.mark.parametrize('presence', [None, Presence(0.8, 1.5, 2.5)], ids=['full', 'partial'])
@pytest.mark.parametrize('cost', [0.0, 1e9], ids=['updated', 'filled'])
def test_a_table_of_little_memory_gives_what_one_of_all_states_gives(
        monkeypatch, name, share, shape, presence, cost):
    # One row at a time.
    monkeypatch.setattr(held_rows, 'STATES_AT_ONCE', 1)
    monkeypatch.setattr(path_table, 'COST_OF_UPDATE', cost)
    generator = np.random.default_rng([len(name), *shape])
    graph = graph_named(name, np.array([0.0, 1, 2, 3, 5, 6, 7, 8, 9]))
    per_frame = presence.per_frame if presence else 0.0
    most = share * table_bytes(graph, shape, presence)
    little = ViterbiTable(graph, shape, presence=presence, most_bytes=most, n_threads=2)
    scores = generator.exponential(size=(9, *shape)).astype(np.float32)
    for number in range(4):
        fresh = ViterbiTable(graph, shape, presence=presence)
        filled = fresh.fill(scores, per_frame)
        level = float(np.quantile(fresh.best, 0.99))
        assert little.update(scores, level, per_frame=per_frame) == filled
        told = np.maximum(little.best, fresh.best) > level
        np.testing.assert_array_equal(little.best[told], fresh.best[told])
        paths = fresh.best_paths(level, 2, 12)
        assert paths
        for few, path in zip(little.best_paths(level, 2, 12), paths, strict=True):
            np.testing.assert_equal(few._asdict(), path._asdict())
        scores = changed(generator, np.pad(scores, ((0, 0), (0, 3), (0, 0))),
                         ('down', 'both')[number % 2])[:, :shape[0]]


def test_a_table_of_little_memory_has_the_value_of_the_best_of_every_path(monkeypatch):
    monkeypatch.setattr(held_rows, 'STATES_AT_ONCE', 1)
    graph = build_state_graph(np.arange(4.0), step_px=1.0, max_speed=0.7, max_acceleration=0.9,
                              turn_cost=0.5)
    assert graph.n_segments > 1
    scores = np.random.default_rng(5).exponential(size=(4, 9, 6)).astype(np.float32)
    expected, _ = naive.best_path_value(graph, scores)
    table = ViterbiTable(graph, (9, 6), most_bytes=0)
    assert table.fill(scores) == pytest.approx(expected, rel=1e-5)
    [path] = table.best_paths(0.0, 2, 1)
    x, y = path.positions.astype(int).T
    assert scores[range(4), y, x].sum() - path.turn_cost == pytest.approx(expected, rel=1e-5)


def test_only_states_that_may_pass_are_computed():
    graph = graph_named('few turns', np.arange(9.0))
    generator = np.random.default_rng(4)
    scores = generator.exponential(size=(9, 99, 199)).astype(np.float32)
    bright = scores.copy()
    bright[:, 50:55, 90:95] += 30
    fresh = ViterbiTable(graph, (99, 199))
    largest = fresh.fill(scores)
    table = ViterbiTable(graph, (99, 199))
    table.update(bright, 40.0)
    passed, met = table.best > 40.0, table.best > fresh.best
    assert table.update(scores, 40.0) == largest
    # What cannot pass is left as it was, which is too much.
    left = table.best > fresh.best
    assert passed.any() and not np.any(left & passed)
    assert np.count_nonzero(left) > np.count_nonzero(met)
    # Nothing has changed, so none of that is computed either.
    table.update(scores.copy(), 40.0)
    np.testing.assert_array_equal(table.best > fresh.best, left)


T, H, W = 8, 26, 34
STAMPS = np.arange(float(T))


def crowd(seed, n_targets, mask, model):
    """Return frames with targets, a mask and an empty path set."""
    generator = np.random.default_rng(seed)
    psf = GaussianPsf(1.0)
    maker = WorkingSet(np.zeros((T, H, W), np.float32), NO_MASK, psf, 1.0, model)
    for _ in range(n_targets):
        start, velocity = generator.uniform(0, 25, 2), generator.uniform(-0.8, 0.8, 2)
        positions = np.clip(start + velocity * STAMPS[:, None], 0, (W - 1, H - 1))
        maker.add(positions, 0.0)
        maker.assign(np.array([len(maker) - 1]), generator.uniform(2, 6, (1, T)))
    frames = generator.standard_normal((T, H, W)).astype(np.float32) - maker.residual
    valid = None
    if mask:
        valid = generator.random((T, H, W)) > 0.1
        valid[:, 10:14, :9] = False
        frames[~valid] = 0
    return frames, valid


@pytest.mark.parametrize('psf', [
    pytest.param(GaussianPsf(1.0), id='gaussian'),
    pytest.param(ArrayPsf(np.random.default_rng(7).random((5, 7))), id='of several components')])
@pytest.mark.parametrize('code', [NON_NEGATIVE, COMPLEX, CONSTANT])
@pytest.mark.parametrize('weighted', [False, True])
def test_frames_that_differ_in_places_are_searched_as_if_new(psf, code, weighted):
    generator = np.random.default_rng(3)
    model = AMPLITUDE_MODELS[code]
    graph = build_state_graph(STAMPS, step_px=1 / psf.oversampling, max_speed=0.5,
                              max_acceleration=0.0, turn_cost=3.0)
    frames = generator.standard_normal((T, H, W)).astype(np.float32)
    if code == COMPLEX:
        frames = (frames + 1j * frames[::-1]).astype(np.complex64)
    kept = path_search(graph, psf, (H, W), model)
    for number in range(7):
        if weighted and number % 3 == 0:
            weights = generator.uniform(0.5, 1.5, (T, H, W))
            kept.set_weights(weights)
        fresh = path_search(graph, psf, (H, W), model)
        fresh.set_weights(weights if weighted else None)
        np.testing.assert_equal(*(
            [dataclasses.astuple(path) for path in search.best_paths(
                frames, 0.0, 3.0, 5)[1]] for search in (kept, fresh)))
        if number == 3:
            kept.best_value(frames[::-1].copy())
        frames = frames.copy()
        y = generator.integers(0, H - 3)
        frames[generator.integers(0, T), y:y + 3, 5:9] += 1 - number % 3


def pursued(frames, valid, model, graph, threshold):
    psf = GaussianPsf(1.0)
    search = path_search(graph, psf, (H, W), model)
    search.set_weights(valid)
    valid = NO_MASK if valid is None else valid
    paths = WorkingSet(frames, valid, psf, threshold, model)
    return pursue(search, Refiner(TargetModel(graph, psf, STAMPS, valid, model)), paths, 3.0,
                  PursuitSettings((1.0, 0.5, 0.0)))


@pytest.mark.parametrize(('code', 'threshold'), [(NON_NEGATIVE, 6.5), (SIGNED, 7.5),
                                                 (CONSTANT, 5.0)])
@pytest.mark.parametrize('mask', [False, True], ids=['', 'masked'])
@pytest.mark.parametrize('seed', [1, 2])
def test_pursuit_is_the_same_with_full_searches(monkeypatch, code, threshold, mask, seed):
    model = AMPLITUDE_MODELS[code]
    frames, valid = crowd(seed, 4, mask, model)
    graph = graph_named('few turns', STAMPS, model.turn_cost)
    # Frames this small are mostly filled anew otherwise.
    monkeypatch.setattr(path_table, 'COST_OF_UPDATE', 0.0)
    quick = pursued(frames, valid, model, graph, threshold)

    def from_the_start(table, scores, level, rows=None, per_frame=0.0):
        return table.fill(scores, per_frame)

    monkeypatch.setattr(ViterbiTable, 'update', from_the_start)
    full = pursued(frames, valid, model, graph, threshold)
    assert len(full.paths) > 0 and len(full.history) > 3
    np.testing.assert_equal(*([dataclasses.astuple(step) for step in result.history]
                              for result in (quick, full)))
    assert quick.gap == full.gap
    np.testing.assert_array_equal(quick.paths.amplitudes, full.paths.amplitudes)
    np.testing.assert_array_equal(quick.paths.positions, full.paths.positions)


@pytest.mark.parametrize('presence', [None, Presence(0.8, 1.5, 2.5)], ids=['full', 'partial'])
@pytest.mark.parametrize('name', GRAPHS)
@pytest.mark.parametrize('most', [0, np.inf])
def test_the_memory_of_a_table_is_told_before_it_is_taken(monkeypatch, name, presence, most):
    monkeypatch.setattr(held_rows, 'STATES_AT_ONCE', 1)
    graph = graph_named(name, np.arange(12.0))
    shape = (23, 690)
    scores = np.zeros((12, *shape), np.float32)
    table = ViterbiTable(graph, shape, presence=presence, most_bytes=most)
    # Compiles, which takes memory of its own.
    ViterbiTable(graph, (9, 9), presence=presence).fill(np.zeros((12, 9, 9), np.float32))
    tracemalloc.start()
    try:
        table.fill(scores)
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # Less margins of a few rows, and what is known of each row.
    assert 0.85 * taken <= table_bytes(graph, shape, presence, most_bytes=most) <= taken


def test_the_memory_of_a_table_is_what_it_may_take_where_that_is_enough(monkeypatch):
    monkeypatch.setattr(held_rows, 'STATES_AT_ONCE', 1)
    graph = build_state_graph(np.arange(20.0), step_px=0.5, max_speed=2.0, max_acceleration=0.1,
                              turn_cost=3.0)
    shape = (400, 300)
    least, most = (table_bytes(graph, shape, most_bytes=bound) for bound in (0, np.inf))
    assert least < most / 3
    taken = [table_bytes(graph, shape, most_bytes=bound)
             for bound in np.linspace(least, most, 20)]
    assert (np.array(taken) <= np.linspace(least, most, 20) + 1).all()
    # More memory lets more segments be held, one after the other.
    assert sorted(set(taken)) == list(dict.fromkeys(taken)) and len(set(taken)) > 3
