"""Playing that is paused, stepped, moved and changed while it runs, over DDS."""

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Path  # noqa: E402
import numpy as np  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from track_before_detect.ros.conversions import seconds_from_time  # noqa: E402

NAME = 'frame_publisher'
STAMPS = 100.0 + 0.25 * np.arange(6)


@pytest.fixture
def player(launch, station, tmp_path):
    """Start playing six frames, paused; each has its number in all pixels."""
    frames = np.repeat(np.arange(6, dtype=np.uint8), 20).reshape(6, 4, 5)
    np.savez(tmp_path / 'six.npz', frames=frames, stamps=STAMPS, truth=[[k, 0, k, 2] for k in
                                                                        range(6)])
    station.listen(DiagnosticArray, '/diagnostics')

    def start(*arguments):
        return launch(NAME, '-p', f'input:={tmp_path / "six.npz"}', '-p', 'start_paused:=true',
                      '-p', 'exit_when_done:=false',
                      *[part for argument in arguments for part in ('-p', argument)])
    return start


def asker(station):
    """Return what calls a service, after parameters were set, and gives the answer."""
    def ask(service, **values):
        if values:
            request = SetParameters.Request(parameters=[
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
            response = station.call(SetParameters, f'{NAME}/set_parameters', request)
            assert [result.reason for result in response.results] == [''] * len(values)
        if service:
            return station.call(Trigger, f'{NAME}/{service}', Trigger.Request())
        return None
    return ask


def test_it_is_stepped_and_moved_and_the_clock_follows(player, station):
    images = station.listen(Image, 'image')
    clock = station.listen(Clock, '/clock')
    player('original_stamps:=true', 'clock_hz:=50.0')
    station.wait_for_diagnostics(NAME, message='paused, next is frame 0 of 6')
    ask = asker(station)

    def played(number):
        station.wait_until(lambda: len(images) >= number, f'{number} frames')
        # Any frame that is too many has time to arrive.
        station.spin_for(0.3)
        return [message.data[0] for message in images]

    assert ask('play_next', step_frames=2).success
    assert played(2) == [0, 1]
    assert seconds_from_time(clock[-1].clock) == STAMPS[1]
    assert ask('seek', seek_s=0.6).message == 'paused, next is frame 3 of 6'
    station.spin_for(0.1)
    assert seconds_from_time(clock[-1].clock) == STAMPS[3]
    assert ask('is_paused').success
    assert ask('resume').success
    assert played(5) == [0, 1, 3, 4, 5]
    assert not ask('is_paused').success
    refused = ask('play_next')
    assert (refused.success, refused.message) == (False, 'not paused: call pause before')
    assert ask('seek_frame', seek_frame=9).message == 'frame 9 is not among those played, 0 to 5'
    stamps = [seconds_from_time(message.header.stamp) for message in images]
    np.testing.assert_array_equal(stamps, STAMPS[[0, 1, 3, 4, 5]])
    found = station.wait_for_diagnostics(NAME, frames_published=5)
    assert found['message'] == 'done, next is frame 6 of 6'


def test_rate_limits_and_loop_are_changed_while_it_plays(player, station):
    images = station.listen(Image, 'image')
    truth = station.listen(Path, 'truth/path')
    publisher = player()
    station.wait_for_diagnostics(NAME, message='paused, next is frame 0 of 6')
    ask = asker(station)
    ask('resume', rate=10.0, loop=True, start_offset_s=0.5, playback_duration_s=0.25)
    station.wait_until(lambda: len(images) >= 7, 'three rounds')
    ask('toggle_paused')
    assert [message.data[0] for message in images[:6]] == [2, 3] * 3
    stamps = np.array([seconds_from_time(message.header.stamp) for message in images])
    # Between two rounds two clocks are read one after the other.
    np.testing.assert_allclose(np.diff(stamps[:6]), 0.025, atol=5e-3)
    # Sent anew with each round, with the stamps of its frames.
    poses = truth[0].poses
    np.testing.assert_allclose(
        [seconds_from_time(pose.header.stamp) for pose in poses[2:4]], stamps[:2], atol=1e-6)
    assert ask('stop').success
    assert 'done: ' in publisher.wait_for_line('done: .*').group()
    assert ask('resume').message == 'done: call play or seek'
