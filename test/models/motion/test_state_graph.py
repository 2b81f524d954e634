"""The state graph holds the motions it is asked for and no faster ones."""

import itertools

import numpy as np
import pytest

from track_before_detect.models.motion.range_doppler import build_range_doppler_graph
from track_before_detect.models.motion.state_graph import build_state_graph, regular_stamps


def graph_for(stamps, speed, acceleration, step=0.5):
    return build_state_graph(stamps, step_px=step, max_speed=speed,
                             max_acceleration=acceleration, turn_cost=1.0)


def test_velocities_fill_the_disc_of_the_maximum_speed():
    graph = graph_for(np.arange(20.0), 1.0, 0.05)
    speeds = np.hypot(*graph.velocities.T)
    assert 1.0 - graph.velocity_step < speeds.max() <= 1.0 + 0.5 * graph.velocity_step + 1e-9
    assert (speeds == 0).sum() == 1
    assert len(np.unique(graph.velocities, axis=0)) == graph.n_velocities


def test_rows_number_the_velocities_in_order():
    graph = graph_for(np.arange(20.0), 1.3, 0.05)
    grid = np.rint(graph.velocities / graph.velocity_step).astype(int)
    extent = -grid[:, 0].min()
    for r in range(len(graph.row_x)):
        row = grid[graph.row_first[r]:graph.row_first[r + 1]]
        assert (row[:, 1] == row[0, 1]).all()
        np.testing.assert_array_equal(row[:, 0], row[0, 0] + np.arange(len(row)))
        assert row[0, 0] + extent == graph.row_x[r]
    assert graph.row_first[-1] == graph.n_velocities


@pytest.mark.parametrize('stamps', [
    pytest.param(np.arange(20.0), id='regular'),
    pytest.param(np.delete(np.arange(24.0), [3, 4, 11]), id='dropped frames'),
])
def test_moves_follow_velocity_times_elapsed_time(stamps):
    graph = graph_for(stamps, 1.0, 0.05)
    for j in range(graph.n_segments):
        first, last = graph.knots[j], graph.knots[j + 1]
        elapsed = stamps[first:last] - stamps[first]
        exact = elapsed[:, None, None] * graph.velocities / graph.step_px
        assert np.abs(graph.moves[first:last] - exact).max() <= 0.5 + 1e-9
    assert graph.knots[0] == 0 and graph.knots[-1] == len(stamps)
    assert (np.diff(graph.knots) > 0).all()


def test_no_acceleration_means_one_segment():
    assert graph_for(np.arange(20.0), 1.0, 0.0).n_segments == 1


def test_no_speed_means_one_velocity():
    graph = graph_for(np.arange(20.0), 0.0, 0.0)
    assert graph.n_velocities == 1 and not graph.moves.any()


def test_velocity_can_change_as_fast_as_asked():
    for acceleration in (0.02, 0.1, 0.5, 2.0):
        graph = graph_for(np.arange(40.0), 3.0, acceleration)
        able = graph.reach * graph.velocity_step / np.mean(np.diff(graph.knots))
        assert 0.4 * acceleration < able < 2.5 * acceleration


def test_jitter_of_the_clock_is_rounded_away_and_dropped_frames_are_not():
    generator = np.random.default_rng(1)
    stamps = np.arange(20) * 0.04 + generator.uniform(-0.002, 0.002, 20)
    np.testing.assert_array_equal(regular_stamps(stamps), np.arange(20.0))
    np.testing.assert_array_equal(regular_stamps(np.delete(np.arange(6.0), 2)),
                                  [0, 1, 3, 4, 5])


GRAPHS = {
    'turning': build_state_graph(np.arange(8.0), step_px=0.5, max_speed=0.4,
                                 max_acceleration=0.12, turn_cost=1.0),
    'straight': build_state_graph(np.array([0.0, 1, 2, 4, 5, 7]), step_px=0.5, max_speed=0.8,
                                  max_acceleration=0.0, turn_cost=1.0),
    'range_doppler': build_range_doppler_graph(
        np.arange(8.0), step_px=0.5, rows_per_column=0.4, still_column=3.0,
        max_acceleration=0.1, turn_cost=1.0),
}


def displacements(graph, first, last):
    """Return how paths move from one frame on."""
    found = set()
    for velocities in itertools.product(range(graph.n_velocities), repeat=graph.n_segments):
        if np.abs(np.diff(graph.grid[list(velocities)], axis=0)).max(initial=0) > graph.reach:
            continue
        starts = np.cumsum([(0, 0), *(graph.end_moves[j, v] for j, v in enumerate(velocities))], 0)
        path = np.concatenate([
            start + graph.moves[begin:end, v] for start, begin, end, v in
            zip(starts[:-1], graph.knots[:-1], graph.knots[1:], velocities, strict=True)])
        found.add(tuple((path[first:last] - path[first]).ravel()))
    return found


@pytest.mark.parametrize(('first', 'last'), [(0, 6), (2, 5), (1, 4), (3, 6), (2, 3)])
@pytest.mark.parametrize('name', GRAPHS)
def test_paths_of_a_slice_are_those_of_the_graph_cut_to_its_frames(name, first, last):
    graph = GRAPHS[name]
    part = graph.slice(slice(first, last))
    assert part.n_frames == last - first
    assert part.moves.shape == (part.n_frames, graph.n_velocities, 2)
    assert part.end_moves.shape == (part.n_segments, graph.n_velocities, 2)
    assert displacements(part, 0, last - first) == displacements(graph, first, last)
    if graph.coupling is not None:
        np.testing.assert_array_equal(part.coupling.shifts(9, 0.5),
                                      graph.coupling.shifts(9, 0.5)[first:last])


def test_the_slice_of_all_frames_is_the_graph():
    for graph in GRAPHS.values():
        assert graph.slice(slice(None)).fingerprint() == graph.fingerprint()
