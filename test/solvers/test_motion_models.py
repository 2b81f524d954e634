"""Constant velocity and standing still: as fine as promised, on frames of any kind."""

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.refine.smooth_motions import motions_of

STAMPS = {
    'regular': np.arange(16.0),
    'dropped frames': np.delete(np.arange(20.0), [3, 4, 9, 17]),
}


def frames_of(positions, shape, amplitude=12.0, seed=1):
    frames = np.random.default_rng(seed).standard_normal(
        (len(positions), *shape), dtype=np.float32)
    for frame, (x, y) in zip(frames, positions, strict=True):
        add_target(frame, x, y, 1.0, amplitude)
    return frames


def graph_of(motion, stamps, **options):
    detector = ConvexDetector(DetectorOptions(motion_model=motion, **options))
    return detector.graph(stamps, (64, 64))


def test_constant_velocities_are_finer_than_a_pixel_per_frame_and_never_turn():
    graph = graph_of('constant_velocity', np.arange(20.0))
    assert graph.n_segments == 1
    assert graph.velocity_step < 0.1
    # Neighbours differ by three half pixels over the batch.
    assert graph.velocity_step * 19 == pytest.approx(1.5)


def test_nothing_moves_in_the_static_model():
    graph = graph_of('static', np.arange(20.0), max_speed_px_s=5.0)
    assert graph.n_velocities == 1 and not graph.moves.any()


@pytest.mark.parametrize('name', STAMPS)
@pytest.mark.parametrize('shape', [(40, 48), (1, 64)])
def test_constant_velocity_is_recovered(name, shape):
    stamps = STAMPS[name]
    velocity = np.array([0.63, -0.27 if shape[0] > 1 else 0.0])
    positions = (14.2, 0.5 * (shape[0] - 1)) + (stamps - stamps.mean())[:, None] * velocity
    positions[:, 0] += 10
    result = tbd.detect(frames_of(positions, shape), stamps, threshold=9,
                        motion_model='constant_velocity')
    [trajectory] = result.trajectories
    assert np.hypot(*(trajectory.positions - positions).T).max() < 0.35
    slope = np.polyfit(stamps, trajectory.positions, 1)[0]
    np.testing.assert_allclose(slope, velocity, atol=0.03)


@pytest.mark.parametrize('motion', ['constant_velocity', 'static'])
def test_single_frame_is_searched(motion):
    frames = frames_of([(20.3, 11.6)], (24, 40))
    [trajectory] = tbd.detect(frames, threshold=7, motion_model=motion).trajectories
    np.testing.assert_allclose(trajectory.positions, [[20.3, 11.6]], atol=0.4)


def test_static_model_finds_what_stands_still_and_not_what_moves():
    stamps = STAMPS['dropped frames']
    still = np.broadcast_to((12.4, 30.1), (len(stamps), 2))
    moving = (20.0, 10.0) + stamps[:, None] * (0.9, 0.0)
    frames = frames_of(still, (40, 48), amplitude=3.0)
    for frame, (x, y) in zip(frames, moving, strict=True):
        add_target(frame, x, y, 1.0, 3.0)
    [trajectory] = tbd.detect(frames, stamps, threshold=9, motion_model='static').trajectories
    np.testing.assert_allclose(trajectory.positions, still, atol=0.3)


@pytest.mark.parametrize('motion', ['nearly_constant_velocity', 'constant_velocity'])
@pytest.mark.parametrize('n_frames', [10, 20, 60])
def test_only_paths_longer_than_a_target_gets_cost_for_their_speed(motion, n_frames):
    stamps = np.arange(float(n_frames))
    graph = graph_of(motion, stamps, max_speed_px_s=0.5)
    motions = motions_of(graph, stamps)

    def cost(speed, angle=0.7):
        return motions.overspeed_cost(
            20 + stamps[:, None] * speed * np.array([np.cos(angle), np.sin(angle)]))

    assert cost(0.5 - 1e-9) == cost(0.2) == cost(0.0) == 0
    # By definition two and a half steps too long cost one turn, twice as much four turns.
    excess = 2.5 * graph.step_px / (n_frames - 1)
    assert cost(0.5 + excess) == pytest.approx(graph.turn_cost)
    assert cost(0.5 + 2 * excess, 2.1) == pytest.approx(4 * graph.turn_cost)


@pytest.mark.parametrize('speed', [1.0, 1.1])
def test_target_a_little_faster_than_told_is_found_once(speed):
    stamps = np.arange(20.0)
    positions = (12.3, 9.8) + speed * stamps[:, None] * [0.8, 0.6]
    for seed in range(5):
        result = tbd.detect(frames_of(positions, (40, 48), 5.0, seed), stamps, threshold=9,
                            max_speed_px_s=1.0)
        [found] = result.trajectories
        assert np.hypot(*(found.positions - positions).T).mean() < 0.3


def test_no_speed_is_larger_than_one_that_crosses_the_frame_in_an_interval():
    stamps = np.arange(4.0)
    assert (graph_of('nearly_constant_velocity', stamps, max_speed_px_s=1e300).fingerprint()
            == graph_of('nearly_constant_velocity', stamps,
                        max_speed_px_s=64 * 2**0.5).fingerprint())
