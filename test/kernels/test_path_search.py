"""The best path equals a search through every path."""

import numpy as np
import pytest

import naive
from track_before_detect.models.state_graph import build_state_graph
from track_before_detect.solvers.path_table import PathTable


def best_of(graph, scores):
    """Return the largest weight of a path by start of its last segment."""
    table = PathTable(graph, scores.shape[1:])
    table.fill(scores)
    return table.best


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
    assert best_of(graph, scores).max() == pytest.approx(expected, rel=1e-5)


def test_reach_of_several_steps_equals_search_through_every_path():
    graph = build_state_graph(np.arange(3.0), step_px=1.0, max_speed=1.5, max_acceleration=2.0,
                              turn_cost=0.7)
    assert graph.reach >= 2
    scores = np.random.default_rng(4).exponential(size=(3, 4, 5)).astype(np.float32)
    expected, _ = naive.best_path_value(graph, scores)
    assert best_of(graph, scores).max() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize('n_frames', [6, 7, 8, 9, 10])
def test_long_segments_over_many_velocities_equal_search_through_every_path(n_frames):
    # Segments of three, four and five frames, and velocities inside and at the rim of the disc.
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1.0, max_speed=1.6,
                              max_acceleration=2.5 / (n_frames / 2)**2, turn_cost=0.8)
    assert graph.n_segments == 2 and graph.reach == 1 and len(graph.row_x) >= 5
    scores = np.random.default_rng(n_frames).exponential(size=(n_frames, 6, 7))
    expected, _ = naive.best_path_value(graph, scores)
    assert best_of(graph, scores.astype(np.float32)).max() == pytest.approx(expected, rel=1e-5)


def test_frame_of_one_row_is_searched():
    graph = build_state_graph(np.arange(4.0), step_px=0.5, max_speed=1.0, max_acceleration=0.3,
                              turn_cost=1.0)
    scores = np.random.default_rng(5).exponential(size=(4, 1, 21)).astype(np.float32)
    expected, _ = naive.best_path_value(graph, scores)
    assert best_of(graph, scores).max() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize('acceleration', [0.0, 0.4, 3.0])
@pytest.mark.parametrize('n_frames', [1, 4, 5])
def test_traced_path_has_the_weight_it_was_found_for(acceleration, n_frames):
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1.0, max_speed=1.6,
                              max_acceleration=acceleration, turn_cost=0.3)
    scores = np.random.default_rng(9).exponential(size=(n_frames, 7, 33)).astype(np.float32)
    table = PathTable(graph, (7, 33))
    table.fill(scores)
    starts = np.array([(0, 0), (3, 17), (6, 32)])
    for (y, x), positions, cost in zip(starts, *table.trace(starts), strict=True):
        columns, rows = positions.astype(int).T
        weight = scores[np.arange(n_frames), rows, columns].sum() - cost
        assert weight == pytest.approx(float(table.best[y, x]), rel=1e-5)


@pytest.mark.parametrize('limit', [0, 3, 500])
def test_peaks_are_the_largest_that_are_left_once_their_surroundings_are_out(limit):
    graph = build_state_graph(np.arange(2.0), step_px=1.0, max_speed=0.0, max_acceleration=0.0,
                              turn_cost=0.3)
    table = PathTable(graph, (23, 31))
    # Whole numbers, so that many are equal.
    table.fill(np.random.default_rng(6).integers(0, 9, (2, 23, 31)).astype(np.float32))
    left, expected = table.best.copy(), []
    while len(expected) < limit and left.max() > 4.0:
        y, x = np.unravel_index(np.argmax(left), left.shape)
        expected.append((y, x))
        left[max(0, y - 2):y + 3, max(0, x - 2):x + 3] = -1
    np.testing.assert_array_equal(table.peaks(4.0, 2, limit), np.reshape(expected, (-1, 2)))


def test_rows_wider_than_a_word_of_vectors_are_searched():
    graph = build_state_graph(np.arange(3.0), step_px=1.0, max_speed=1.0, max_acceleration=1.0,
                              turn_cost=0.5)
    scores = np.random.default_rng(8).exponential(size=(3, 2, 2500)).astype(np.float32)
    wide = best_of(graph, scores)
    # What lies far enough away does not matter.
    parts = [best_of(graph, scores[:, :, first:first + 1000]) for first in (0, 1500)]
    np.testing.assert_allclose(wide[:, :990], parts[0][:, :990], rtol=1e-5)
    np.testing.assert_allclose(wide[:, 1510:], parts[1][:, 10:], rtol=1e-5)
