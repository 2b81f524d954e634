"""The frame publisher as a process, heard over DDS, and with the detector behind it."""

import re
import signal

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Path  # noqa: E402
import numpy as np  # noqa: E402
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Image, PointCloud2  # noqa: E402
from std_msgs.msg import Float32MultiArray  # noqa: E402

from track_before_detect.recordings.encodings import multiarray_stamp  # noqa: E402
from track_before_detect.recordings.npz import write_npz_recording  # noqa: E402
from track_before_detect.ros import conversions  # noqa: E402
from track_before_detect.simulation.scenarios import simulate  # noqa: E402

RELIABLE = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=100, reliability=QoSReliabilityPolicy.RELIABLE,
                     durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize(('dtype', 'encoding'), [
    (np.uint8, 'mono8'), (np.uint16, 'mono16'), (np.float32, '32FC1'), (np.float64, '64FC1')])
def test_a_replayed_file_arrives_bit_for_bit_with_its_stamps(
        launch, station, tmp_path, dtype, encoding):
    rng = np.random.default_rng(1)
    frames = (200 * rng.random((5, 7, 9))).astype(dtype)
    stamps = np.array([10.0, 10.5, 10.625, 11.0, 12.0])
    np.savez(tmp_path / 'recording.npz', frames=frames, stamps=stamps)
    messages = station.listen(Image, 'image', RELIABLE)
    publisher = launch(
        'frame_publisher', '-p', f'input:={tmp_path / "recording.npz"}', '-p', 'rate_hz:=100.0',
        '-p', 'original_stamps:=true', '-p', 'frame_id:=sensor')
    station.wait_until(lambda: len(messages) == 5, 'five frames')
    assert publisher.wait() == 0
    for message, frame, stamp in zip(messages, frames, stamps):
        assert message.encoding == encoding
        assert message.header.frame_id == 'sensor'
        assert conversions.seconds_from_time(message.header.stamp) == stamp
        np.testing.assert_array_equal(conversions.frame_from_image(message), frame)


def test_a_file_with_wrong_stamps_is_played_to_its_end(launch, station, tmp_path):
    frames = np.arange(5 * 7 * 9, dtype=np.float32).reshape(5, 7, 9)
    np.savez(tmp_path / 'recording.npz', frames=frames, stamps=[0.0, 10.0, np.nan, 10.2, 5.0])
    messages = station.listen(Image, 'image', RELIABLE)
    publisher = launch(
        'frame_publisher', '-p', f'input:={tmp_path / "recording.npz"}', '-p', 'rate_hz:=100.0',
        '-p', 'original_stamps:=true')
    station.wait_until(lambda: len(messages) == 5, 'five frames')
    assert publisher.wait() == 0
    assert '2 of 5 stamps do not increase' in publisher.output
    stamps = [conversions.seconds_from_time(message.header.stamp) for message in messages]
    np.testing.assert_allclose(stamps, [0.0, 10.0, 10.1, 10.2, 10.2])


def test_a_scenario_arrives_as_stamped_arrays_with_its_truth(launch, station):
    frames = station.listen(Float32MultiArray, 'frame', RELIABLE)
    truth = station.listen(Path, 'truth/path', LATCHED)
    publisher = launch(
        'frame_publisher', '-p', 'scenario:=three_targets', '-p', 'seed:=4', '-p',
        'message:=frame', '-p', 'rate_hz:=100.0', '-p', 'original_stamps:=true', '-p',
        'scenario_set:=n_frames=15 snr=6', '-p', 'frame_id:=left camera')
    station.wait_until(lambda: len(frames) == 15 and len(truth) == 3, 'frames and truth')
    assert publisher.wait() == 0
    assert 'done: 15 frames published' in publisher.output
    simulated = simulate('three_targets', 4, n_frames=15, snr=6.0)
    for message, frame, stamp_s in zip(frames, simulated.frames, simulated.stamps):
        np.testing.assert_array_equal(conversions.frame_from_multiarray(message), frame)
        stamp = multiarray_stamp(dim.label for dim in message.layout.dim)
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(stamp_s, abs=1e-9)
        assert stamp.frame_id == 'left camera'
    for message, target in zip(truth, range(3)):
        rows = simulated.truth[simulated.truth[:, 1] == target]
        positions = [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses]
        np.testing.assert_allclose(positions, rows[:, 2:])
        stamps = [conversions.seconds_from_time(pose.header.stamp) for pose in message.poses]
        np.testing.assert_allclose(stamps, simulated.stamps, atol=1e-9)


@pytest.mark.alone
def test_new_stamps_keep_the_intervals_and_do_not_jump_in_a_loop(
        launch, station, tmp_path, moving_target):
    frames, _ = moving_target(4)
    np.savez(tmp_path / 'short.npz', frames=frames, fps=50.0)
    messages = station.listen(Image, 'image', RELIABLE)
    before_s = 1e-9 * station.node.get_clock().now().nanoseconds
    publisher = launch(
        'frame_publisher', '-p', f'input:={tmp_path / "short.npz"}', '-p', 'loop:=true')
    station.wait_until(lambda: len(messages) >= 14, 'three rounds')
    assert publisher.interrupt() == 0
    assert 'Traceback' not in publisher.output
    stamps = np.array([conversions.seconds_from_time(m.header.stamp) for m in messages])
    assert stamps[0] > before_s
    np.testing.assert_allclose(np.diff(stamps[:4]), 0.02, atol=1e-6)
    # Between two rounds two clocks are read one after the other.
    np.testing.assert_allclose(np.diff(stamps), 0.02, atol=5e-3)


def test_a_single_frame_is_looped_at_the_rate_that_is_asked_for(launch, station, tmp_path):
    np.savez(tmp_path / 'single.npz', frames=np.zeros((1, 4, 5), np.uint8))
    messages = station.listen(Image, 'image', RELIABLE)
    launch('frame_publisher', '-p', f'input:={tmp_path / "single.npz"}', '-p', 'loop:=true',
           '-p', 'rate_hz:=20.0')
    station.wait_until(lambda: len(messages) >= 4, 'four rounds')
    stamps = [conversions.seconds_from_time(message.header.stamp) for message in messages]
    assert np.median(np.diff(stamps)) == pytest.approx(0.05, abs=0.01)


def test_it_waits_for_a_subscriber_before_the_first_frame(launch, station):
    # None is lost while a busy machine does not listen.
    publisher = launch('frame_publisher', '-p', 'rate_hz:=200.0', '-p',
                       'qos_overrides./image.publisher.depth:=100')
    publisher.wait_for_line('waiting for a subscriber of /image')
    messages = station.listen(Image, 'image', RELIABLE)
    station.wait_until(lambda: len(messages) == 40, 'all frames')
    assert publisher.wait() == 0


@pytest.mark.parametrize(('argument', 'sentence'), [
    ('input:=/none.npz', '/none.npz does not exist'),
    ('scenario:=nonsense', "unknown scenario 'nonsense'"),
    ('message:=picture', "message must be one of image, frame, got 'picture'"),
    ('rate_h:=3.0', "unknown parameter 'rate_h'; did you mean rate_hz?"),
    ('rate_hz:=-3', 'rate_hz must be at least 0 Hz, got -3'),
    ('topic:=camera', 'belongs to a bag'),
    ('clock_hz:=1e-300', 'clock_hz must be 0 or at least 0.001, got 1e-300'),
    ('scenario_set:=snr', "scenario_set needs KEY=VALUE, got 'snr'"),
    ('scenario_set:=sn=2', "unknown parameter 'sn' of a scenario; did you mean snr?"),
    ('start_offset_s:=3.0', 'must leave a frame, but they lie at 0 to 1.56 s'),
])
def test_a_bad_parameter_is_one_sentence_and_exit_code_2(launch, argument, sentence):
    publisher = launch('frame_publisher', '-p', argument)
    assert publisher.wait() == 2
    assert publisher.output.count('\n') == 1
    assert publisher.output.startswith('frame_publisher: error: ')
    assert sentence in publisher.output


@pytest.mark.parametrize(('kind', 'sentence'), [
    (np.complex64, 'complex frames cannot be sent'),
    (np.uint8, 'holds no stamp below 0 s, got -1.5 s: take message=image')])
def test_frames_that_cannot_be_sent_are_refused_at_start(launch, tmp_path, kind, sentence):
    np.savez(tmp_path / 'a.npz', frames=np.zeros((2, 4, 4), kind), stamps=[-1.5, 2.0])
    publisher = launch('frame_publisher', '-p', f'input:={tmp_path / "a.npz"}', '-p',
                       'message:=frame', '-p', 'original_stamps:=true')
    assert publisher.wait() == 2
    assert sentence in publisher.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly_while_it_waits(launch, number):
    publisher = launch('frame_publisher')
    publisher.wait_for_line('waiting for a subscriber')
    assert publisher.interrupt(number) == 0
    assert 'Traceback' not in publisher.output


def test_both_nodes_together_use_every_frame_and_find_the_target(
        launch, station, tmp_path, moving_target):
    frames, positions = moving_target(47)
    rows = np.column_stack([np.arange(47), np.zeros(47), positions])
    write_npz_recording(tmp_path / 'target.npz', frames, np.arange(47) / 25.0, rows)
    clouds = station.listen(PointCloud2, 'trajectories/points')
    station.listen(DiagnosticArray, '/diagnostics')
    detector = launch(
        'detector', '-p', 'threshold:=12.0', '-p', 'frame_height:=32', '-p', 'frame_width:=40',
        '-p', 'frame_rate_hz:=25.0', '-p', 'qos_overrides./image.subscription.depth:=100')
    # Its loops may have to be compiled first.
    detector.wait_for_line(r'ready: .*threshold', timeout_s=240.0)
    # A node that is ready at once may publish before it knows who listens.
    station.wait_for_diagnostics(state='ready')
    publisher = launch(
        'frame_publisher', '-p', f'input:={tmp_path / "target.npz"}', '-p',
        'original_stamps:=true')
    assert publisher.wait() == 0
    found = station.wait_for_diagnostics(frames_used=47, batches=4)
    assert found['frames_dropped'] == found['failures'] == '0'
    station.wait_until(lambda: len(clouds) == 4, 'four clouds')
    points = np.concatenate([conversions.points_to_array(cloud) for cloud in clouds])
    frame = np.rint(points['t'] * 25.0).astype(int)
    assert set(frame) == set(range(47))
    error = np.hypot(points['x'] - positions[frame, 0], points['y'] - positions[frame, 1])
    assert np.mean(error < 1.5) > 0.95


@pytest.mark.alone
def test_thirty_frames_a_second_of_128_x_128_with_hop_10_are_kept_up_with(launch, station):
    station.listen(DiagnosticArray, '/diagnostics')
    # With best effort the middleware may lose a frame, which is not the node's doing.
    detector = launch(
        'detector', '-p', 'frame_height:=128', '-p', 'frame_width:=128', '-p',
        'frame_rate_hz:=30.0', '-p', 'hop:=10', '-p', 'preset:=none', '-p', 'reliable:=true')
    detector.wait_for_line(r'ready: .*threshold', timeout_s=300.0)
    launch('frame_publisher', '-p', 'rate_hz:=30.0', '-p', 'loop:=true', '-p',
           'wait_for_subscriber:=true')
    found = station.wait_until(
        lambda: int(station.diagnostics().get('batches', 0)) >= 15 and station.diagnostics(),
        'fifteen batches')
    assert found['frames_dropped'] == found['failures'] == found['messages_lost'] == '0'
    received, used, waiting = (
        int(found[f'frames_{what}']) for what in ('received', 'used', 'waiting'))
    assert received == used + waiting
    # Fifteen batches are reached from 160 frames on; more than a batch behind is not keeping up.
    assert received < 160 + 40
    assert re.search(r'^\d', found['processing_time_ms'])
