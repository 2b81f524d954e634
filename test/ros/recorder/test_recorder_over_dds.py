"""The recorder as a process: what it recorded can be read, also when it was killed."""

import resource
import signal

import pytest

pytest.importorskip('rclpy')
pytest.importorskip('mcap')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
import numpy as np  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rosbags.rosbag2 import Reader  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402

from track_before_detect.errors import ParameterError  # noqa: E402
from track_before_detect.recordings.open_recording import open_recording  # noqa: E402
from track_before_detect.ros.recorder.recorder_node import RecorderNode  # noqa: E402

STAMPS = 100.0 + 0.05 * np.arange(8)


@pytest.fixture
def played(launch, station, tmp_path):
    """Play eight frames again and again, as soon as the recorder listens."""
    frames = np.random.default_rng(1).integers(0, 256, (8, 40, 50), np.uint8)
    truth = [[k, 0, k, 2] for k in range(8)]
    np.savez(tmp_path / 'eight.npz', frames=frames, stamps=STAMPS, truth=truth)
    launch('frame_publisher', '-p', f'input:={tmp_path / "eight.npz"}', '-p', 'loop:=true', '-p',
           'original_stamps:=true')
    station.listen(DiagnosticArray, '/diagnostics')
    return frames


def record(launch, station, path, n_messages):
    """Start recording; return its process once so much is safe in the file."""
    recorder = launch('recorder', '-p', f'output:={path}', '-p', 'commit_period_s:=0.1')
    station.wait_until(lambda: int(station.diagnostics('recorder').get(
        'messages of /image', 0)) >= n_messages, f'{n_messages} messages')
    n_bytes = int(station.diagnostics('recorder')['bytes_safe'])
    station.wait_until(
        lambda: int(station.diagnostics('recorder')['bytes_safe']) > n_bytes, 'a commit')
    return recorder


def check_frames(recording, played):
    """Compare frames with those that were played round after round, from any of them on."""
    begin = round((recording.stamps[0] - STAMPS[0]) / 0.05)
    for index, stamp in enumerate(recording.stamps):
        number = (begin + index) % len(played)
        assert stamp == STAMPS[number]
        np.testing.assert_array_equal(recording[index], played[number])


def test_what_was_recorded_before_a_kill_can_be_read(launch, station, tmp_path, played):
    path = tmp_path / 'killed.mcap'
    recorder = record(launch, station, path, 20)
    recorder.interrupt(signal.SIGKILL)
    with open_recording(path, '/image') as recording:
        assert len(recording) >= 20
        check_frames(recording, played)
    with Reader(path) as reader:
        store = get_typestore(Stores.ROS2_JAZZY)
        paths = [store.deserialize_cdr(raw, connection.msgtype)
                 for connection, _, raw in reader.messages() if connection.topic == '/truth/path']
    assert [pose.pose.position.x for pose in paths[0].poses] == list(range(8))


def test_a_full_disk_is_said_and_recording_goes_on_when_there_is_room(
        launch, station, tmp_path, played):
    path = tmp_path / 'full.mcap'
    recorder = record(launch, station, path, 4)
    pid, (_, hard) = recorder.process.pid, resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, hard))
    recorder.wait_for_line(r'full\.mcap cannot be written: .*; what comes is held')
    found = station.wait_until(
        lambda: station.diagnostics('recorder')['level'] == b'\x02'
        and station.diagnostics('recorder'), 'an error in the diagnostics')
    assert 'cannot be written' in found['message']
    with open_recording(path, '/image') as recording:
        n_frames = len(recording)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
    recorder.wait_for_line(r'full\.mcap can be written again')
    assert recorder.interrupt() == 0
    n_messages = int(recorder.wait_for_line(r'done: (\d+) messages of .* 0 left out').group(1))
    with open_recording(path, '/image') as recording:
        assert len(recording) > n_frames
        check_frames(recording, played)
    with open(path, 'rb') as file:
        reader = make_reader(file)
        assert reader.get_summary().statistics.message_count == n_messages
        assert len(list(reader.iter_messages())) == n_messages


@pytest.mark.parametrize(('values', 'sentence'), [
    ({'output': 'recording.bag'}, 'output must end with .mcap, got recording.bag'),
    ({'output': '/nowhere/a.mcap'}, 'output /nowhere/a.mcap cannot be made: No such file'),
    ({'topics': ' '}, 'topics must name a topic at least'),
    ({'topics': 'image a-b'}, "topics must be names of topics, got 'a-b'"),
])
def test_a_parameter_of_no_use_is_one_sentence(station, values, sentence):
    with pytest.raises(ParameterError, match=sentence):
        RecorderNode(context=station.node.context, parameter_overrides=[
            Parameter(name, value=value) for name, value in values.items()])


def test_a_parameter_that_is_not_known_leaves_no_file_behind(launch, tmp_path):
    path = tmp_path / 'a.mcap'
    recorder = launch('recorder', '-p', f'output:={path}', '-p', 'topcs:=image')
    assert recorder.wait() == 2
    assert 'did you mean topics?' in recorder.output and not path.exists()


def test_a_recording_is_never_overwritten(launch, tmp_path):
    path = tmp_path / 'precious.mcap'
    path.write_bytes(b'old')
    recorder = launch('recorder', '-p', f'output:={path}')
    assert recorder.wait() == 2
    assert recorder.output.endswith(
        f'\nrecorder: error: output {path} cannot be made: File exists\n')
    assert path.read_bytes() == b'old'
