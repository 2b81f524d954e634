"""The best path equals a search through every path."""

import dataclasses

import numba
import numpy as np
import pytest

import naive
from track_before_detect.kernels.search import viterbi
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.solvers.search.viterbi_table import ViterbiTable

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT),
    reason='the recursion turns vectors and borrows arrays by intrinsics, which Python has not')


def best_of(graph, scores):
    """Return the largest weight of a path by start of its last segment."""
    table = ViterbiTable(graph, scores.shape[1:])
    table.fill(scores)
    return table.best[0]


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


@pytest.mark.parametrize('n_frames', [2, 4, 6, 8, 9, 11])
def test_columns_of_many_velocities_equal_the_best_of_every_turn(n_frames):
    # Two segments of one to six frames.
    velocity_step = 6 / n_frames if n_frames > 2 else 1.0
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1.0,
                              max_speed=3.2 * velocity_step, turn_cost=0.8,
                              max_acceleration=12 / n_frames**2)
    graph = dataclasses.replace(graph, reach=1)
    assert graph.n_segments == 2 and len(graph.row_x) == 7
    scores = np.random.default_rng(n_frames).exponential(size=(n_frames, 8, 20))
    expected = best_after_two_segments(graph, scores)
    possible = expected > 0
    best = best_of(graph, scores.astype(np.float32))
    np.testing.assert_allclose(best[possible], expected[possible], rtol=1e-5)
    assert possible.any() and (best[~possible] < 0).all()


def best_after_two_segments(graph, scores):
    """Return what ``best_of`` does for a graph of two segments, turn by turn."""
    n_frames, n_y, n_x = scores.shape
    middle, grid = graph.knots[1], graph.grid

    def met(t, y, x):
        return scores[t, y, x] if 0 <= y < n_y and 0 <= x < n_x else -np.inf

    sums = np.full((2, graph.n_velocities, n_y, n_x), -np.inf)
    for v, y, x in np.ndindex(sums.shape[1:]):
        for j, frames in enumerate((range(middle), range(middle, n_frames))):
            sums[j, v, y, x] = sum(met(t, y + graph.moves[t, v, 1], x + graph.moves[t, v, 0])
                                   for t in frames)
    best = np.full((n_y, n_x), -np.inf)
    for v, other in np.ndindex(graph.n_velocities, graph.n_velocities):
        turn = np.abs(grid[v] - grid[other])
        if turn.max() > 1:
            continue
        move_x, move_y = graph.end_moves[0, other]
        for y, x in np.ndindex(n_y, n_x):
            if 0 <= y - move_y < n_y and 0 <= x - move_x < n_x:
                best[y, x] = max(best[y, x], sums[0, other, y - move_y, x - move_x]
                                 + sums[1, v, y, x] - graph.turn_cost * turn.sum())
    return best


@pytest.mark.parametrize('max_speed', [0.7, 1.6, 2.5])
def test_rows_that_are_not_asked_for_are_not_written(max_speed):
    graph = build_state_graph(np.arange(3.0), step_px=1.0, max_speed=max_speed,
                              max_acceleration=3.0, turn_cost=0.8)
    graph = dataclasses.replace(graph, reach=1)
    table = ViterbiTable(graph, (9, 40))
    table.fill(np.random.default_rng(7).exponential(size=(3, 9, 40)).astype(np.float32))
    layout, value = table._layout, np.full_like(table._tables, 5.0)
    marks = np.full((9, layout.n_v), np.uint64(3))
    viterbi.extend_paths(value, np.empty((0, 0), np.float32), table._tables, table._scores,
                         table._segments[1], layout, None, marks, marks[:, 0].copy(), 2, 6)
    row = layout.n_v * layout.stride
    first = table._places[1, 2, 0]
    asked = slice(first, first + 4 * row)
    assert (value[:asked.start] == 5.0).all() and (value[asked.stop:] == 5.0).all()
    written = value[asked].reshape(-1, layout.stride)[:, :layout.n_x]
    expected = table._tables[asked].reshape(-1, layout.stride)[:, :layout.n_x]
    np.testing.assert_array_equal(written, expected)


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
    table = ViterbiTable(graph, (7, 33))
    table.fill(scores)
    found = table.best_paths(-np.inf, 2, 20)
    assert len(found) > 5 and found[0].value == table.best.max()
    for path in found:
        columns, rows = path.positions.astype(int).T
        weight = scores[np.arange(n_frames), rows, columns].sum() - path.turn_cost
        assert weight == pytest.approx(path.value, rel=1e-5)


@pytest.mark.parametrize('limit', [0, 3, 500])
def test_peaks_are_the_largest_that_are_left_once_their_surroundings_are_out(limit):
    graph = build_state_graph(np.arange(2.0), step_px=1.0, max_speed=0.0, max_acceleration=0.0,
                              turn_cost=0.3)
    table = ViterbiTable(graph, (23, 31))
    # Whole numbers, so that many are equal.
    table.fill(np.random.default_rng(6).integers(0, 9, (2, 23, 31)).astype(np.float32))
    left, expected = table.best[0].copy(), []
    while len(expected) < limit and left.max() > 4.0:
        y, x = np.unravel_index(np.argmax(left), left.shape)
        expected.append((y, x))
        left[max(0, y - 2):y + 3, max(0, x - 2):x + 3] = -1
    found = [path.positions[-1, ::-1] for path in table.best_paths(4.0, 2, limit)]
    np.testing.assert_array_equal(np.reshape(found, (-1, 2)), np.reshape(expected, (-1, 2)))


def test_rows_wider_than_a_word_of_vectors_are_searched():
    graph = build_state_graph(np.arange(3.0), step_px=1.0, max_speed=1.0, max_acceleration=1.0,
                              turn_cost=0.5)
    scores = np.random.default_rng(8).exponential(size=(3, 2, 2500)).astype(np.float32)
    wide = best_of(graph, scores)
    # What lies far enough away does not matter.
    parts = [best_of(graph, scores[:, :, first:first + 1000]) for first in (0, 1500)]
    np.testing.assert_allclose(wide[:, :990], parts[0][:, :990], rtol=1e-5)
    np.testing.assert_allclose(wide[:, 1510:], parts[1][:, 10:], rtol=1e-5)
