"""Targets are carried on from the last batch to the newest frame, and corrected by the next."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.qos import QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from track_before_detect.options import DetectorOptions  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.ros.outputs.head import Head, State  # noqa: E402
from track_before_detect.ros.search_results import StreamResult  # noqa: E402
from track_before_detect.simulation.sensor import add_target  # noqa: E402
from track_before_detect.tracking.pipeline import TrackingPipeline  # noqa: E402
from track_before_detect.types import DetectionResult, FrameBatch, Trajectory  # noqa: E402

T, HOP = 10, 5
OPTIONS = DetectorOptions(max_acceleration_px_s2=0.0)


def result(first, *trajectories):
    numbers = np.arange(first, first + T)
    batch = FrameBatch(np.zeros((T, 4, 30)), numbers.astype(float), numbers)
    return StreamResult(DetectionResult(list(trajectories), 9.0), batch, {}, 1.0, HOP)


def trajectory(identity, first, start, velocity):
    numbers = np.arange(first, first + T)
    stamps = numbers.astype(float)
    return Trajectory(
        identity, np.array(start) + np.outer(stamps, velocity), np.full(T, 7.0),
        np.tile(velocity, (T, 1)), stamps, numbers, 20.0, 6.0,
        covariance=(0.1 + 0.01 * (stamps - first - 4.5)**2)[:, None, None] * np.diag([1.0, 2.0]))


def test_a_line_is_carried_on_with_the_covariance_of_a_line():
    head = Head()
    head.update(result(0, trajectory(3, 0, (5.0, 1.0), (2.0, -0.5))), OPTIONS)
    [target] = head.at(12.5)
    np.testing.assert_allclose(target.position, (30.0, -5.25))
    np.testing.assert_allclose(target.velocity, (2.0, -0.5))
    np.testing.assert_allclose(target.covariance, (0.1 + 0.01 * 8.0**2) * np.diag([1.0, 2.0]))
    assert (target.id, target.state, target.amplitude) == (3, State.TENTATIVE, 7.0)
    assert head.at(12.5) is None
    head.update(result(0, trajectory(3, 0, (5.0, 1.0), (2.0, -0.5))),
                OPTIONS.replace(max_acceleration_px_s2=0.6))
    [bent] = head.at(13.0)
    assert bent.covariance[0, 0] == pytest.approx(0.1 + 0.01 * 8.5**2 + (0.3 * 4.0**2)**2 / 3)


def test_targets_are_confirmed_by_a_second_batch_and_ended_once():
    head = Head()
    both = [trajectory(1, 0, (5.0, 1.0), (0.5, 0.0)), trajectory(2, 0, (9.0, 1.0), (0.0, 0.0))]
    head.update(result(0, *both), OPTIONS)
    assert [one.state for one in head.at(10.0)] == [State.TENTATIVE] * 2
    # The second leaves in the middle of its batch.
    left = trajectory(2, 5, (9.0, 1.0), (0.0, 0.0))
    left.positions[6:] = np.nan
    head.update(result(5, trajectory(1, 5, (5.4, 1.0), (0.5, 0.0)), left), OPTIONS)
    [first, second] = head.at(15.0)
    assert (first.id, first.state, first.position[0]) == (1, State.CONFIRMED, 5.4 + 7.5)
    assert (second.id, second.state) == (2, State.ENDED)
    assert [one.id for one in head.at(16.0)] == [1]
    # Nothing is carried on for long where no batch follows.
    assert head.at(14.0 + 3 * HOP + 1.0) == []
    head.clear()
    assert [(one.id, one.state) for one in head.at(2.0)] == [(1, State.ENDED)]
    assert head.at(3.0) == []


def test_columns_that_go_round_are_followed_across_the_seam():
    one = trajectory(1, 0, (21.0, 1.0), (1.0, 0.0))
    one.positions[:, 0] %= 30
    head = Head()
    head.update(result(0, one), OPTIONS.replace(motion_model='range_bearing'))
    [target] = head.at(12.0)
    np.testing.assert_allclose((*target.position, target.velocity[0]), (3.0, 1.0, 1.0))


def test_errors_are_those_of_the_covariance():
    options = DetectorOptions(threshold=9.0, max_speed_px_s=1.5, max_acceleration_px_s2=0.01)
    squared = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        turn = rng.uniform(0, 2 * np.pi)
        positions = 20.0 + np.outer(np.arange(16.0) - 6, 0.6 * np.array([np.cos(turn),
                                                                        np.sin(turn)]))
        frames = rng.standard_normal((12, 40, 40)).astype(np.float32)
        for frame, place in zip(frames, positions):
            add_target(frame, *place, 1.0, 4.0)
        batch = FrameBatch.of(frames, np.arange(12.0))
        found = TrackingPipeline(options).process(batch)
        head = Head()
        head.update(StreamResult(found, batch, {}, 1.0, 6), options)
        [target] = head.at(15.0)
        error = target.position - positions[15]
        squared.append(error @ np.linalg.solve(target.covariance, error) / 2)
    assert 0.4 < np.mean(squared) < 2.5


def test_the_newest_frame_has_its_targets_before_its_batch_is_due(launch, station, moving_target):
    clouds = station.listen(PointCloud2, 'trajectories/head')
    batches = station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    launch('detector', '-p', 'publish:=head', '-p', 'reliable:=true', '-p', 'threshold:=12.0',
           '-p', 'batch_length:=10', '-p', 'hop:=5', '-p', 'max_speed_px_s:=25.0', '-p',
           'frame_height:=32', '-p', 'frame_width:=40', '-p', 'frame_rate_hz:=25.0')
    station.wait_for_diagnostics(state='ready')
    publisher = station.publisher(Image, 'image', QoSProfile(
        depth=100, reliability=QoSReliabilityPolicy.RELIABLE))
    frames, positions = moving_target(23)
    for k, frame in enumerate(frames):
        publisher.publish(conversions.image_from_frame(frame, Header(
            stamp=conversions.time_from_seconds(100.0 + k / 25.0), frame_id='camera')))
        n_batches = max(0, (k - 4) // 5)
        station.wait_until(lambda n=n_batches, m=k + 1: (len(batches), len(clouds)) == (n, m),
                           'a head for each frame')
    heads = [conversions.points_to_array(cloud) for cloud in clouds]
    assert [len(head) for head in heads] == [0] * 10 + [1] * 13
    seen = np.concatenate(heads)
    assert set(seen['id']) == {1}
    assert seen['state'].tolist() == [State.TENTATIVE] * 5 + [State.CONFIRMED] * 8
    np.testing.assert_allclose(seen['t'], 100.0 + np.arange(10, 23) / 25.0, atol=1e-6)
    error = np.hypot(seen['x'] - positions[10:, 0], seen['y'] - positions[10:, 1])
    assert error.max() < 2.0 and error.mean() < 0.7
    assert {cloud.header.frame_id for cloud in clouds} == {'camera'}
