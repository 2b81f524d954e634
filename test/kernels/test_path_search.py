"""The best path equals a search through every path."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels import path_search as kernel
from track_before_detect.models.state_graph import build_state_graph


def run(graph, scores):
    """Run all segments and return the table of each."""
    values = []
    n_x = scores.shape[2]
    before = np.empty((0, graph.n_velocities, n_x), np.float32)
    end_moves = np.zeros((graph.n_velocities, 2), np.int32)
    for j in range(graph.n_segments):
        value = np.empty((scores.shape[1], graph.n_velocities, n_x), np.float32)
        kernel.forward_segment(
            value, before, scores, graph.moves, end_moves, graph.knots[j], graph.knots[j + 1],
            graph.row_first, graph.row_x, graph.reach, np.float32(graph.turn_cost), 0,
            scores.shape[1])
        values.append(value)
        before, end_moves = value, graph.end_moves[j]
    return values


@pytest.mark.parametrize('stamps', [
    pytest.param(np.arange(4.0), id='regular'),
    pytest.param(np.array([0.0, 1, 2, 4]), id='dropped frame'),
    pytest.param(np.arange(9.0), id='long'),
])
@pytest.mark.parametrize('acceleration', [0.0, 0.2, 0.9, 3.0])
@pytest.mark.parametrize('cost', [0.0, 1.5])
def test_best_path_equals_search_through_every_path(stamps, acceleration, cost):
    graph = build_state_graph(stamps, step_px=1.0, max_speed=0.7, max_acceleration=acceleration,
                              turn_cost=cost)
    if graph.n_velocities**graph.n_segments > 20000:
        graph = build_state_graph(stamps[:4], step_px=1.0, max_speed=0.7,
                                  max_acceleration=acceleration, turn_cost=cost)
    generator = np.random.default_rng(3)
    scores = generator.exponential(size=(graph.n_frames, 4, 5)).astype(np.float32)
    expected, _ = naive.best_path_value(graph, scores)
    assert run(graph, scores)[-1].max() == pytest.approx(expected, rel=1e-5)


def test_reach_of_several_steps_equals_search_through_every_path():
    graph = build_state_graph(np.arange(3.0), step_px=1.0, max_speed=1.5, max_acceleration=2.0,
                              turn_cost=0.7)
    assert graph.reach >= 2
    scores = np.random.default_rng(4).exponential(size=(3, 4, 5)).astype(np.float32)
    expected, _ = naive.best_path_value(graph, scores)
    assert run(graph, scores)[-1].max() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize('n_frames', [6, 7, 8, 9, 10])
def test_long_segments_over_many_velocities_equal_search_through_every_path(n_frames):
    # Segments of three, four and five frames, and velocities inside and at the rim of the disc.
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1.0, max_speed=1.6,
                              max_acceleration=2.5 / (n_frames / 2)**2, turn_cost=0.8)
    assert graph.n_segments == 2 and graph.reach == 1 and len(graph.row_x) >= 5
    scores = np.random.default_rng(n_frames).exponential(size=(n_frames, 6, 7))
    expected, _ = naive.best_path_value(graph, scores)
    assert run(graph, scores.astype(np.float32))[-1].max() == pytest.approx(expected, rel=1e-5)


def test_frame_of_one_row_is_searched():
    graph = build_state_graph(np.arange(4.0), step_px=0.5, max_speed=1.0, max_acceleration=0.3,
                              turn_cost=1.0)
    scores = np.random.default_rng(5).exponential(size=(4, 1, 21)).astype(np.float32)
    expected, _ = naive.best_path_value(graph, scores)
    assert run(graph, scores)[-1].max() == pytest.approx(expected, rel=1e-5)


def test_best_by_position_is_the_maximum_over_velocities():
    value = np.random.default_rng(6).standard_normal((4, 7, 5)).astype(np.float32)
    best = np.empty((4, 5), np.float32)
    kernel.best_by_position(value, best, 0, 4)
    np.testing.assert_array_equal(best, value.max(axis=1))
