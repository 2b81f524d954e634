"""The demo: both nodes and a listener as three processes over DDS."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('matplotlib')

from std_msgs.msg import Header

import track_before_detect as tbd
from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.ros import conversions
from track_before_detect.ros.demo.play import joined_batches
from track_before_detect.ros.demo.report import report
from track_before_detect.simulation.sensor import add_target
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch, Trajectory

TIMEOUT_S = 180.0


@pytest.fixture
def recording(tmp_path, moving_target):
    """Return the path of a recording with one bright target."""
    frames, positions = moving_target(30)
    truth = np.column_stack([np.arange(30), np.zeros(30), positions])
    path = tmp_path / 'bright target.npz'
    write_npz_recording(path, frames, np.arange(30) / 25.0, truth)
    return path


@pytest.fixture
def start_demo(tmp_path, ros_domain):
    """Start demos, and end them with the test."""
    started = []
    source = str(Path(tbd.__file__).parents[1])
    path = os.pathsep.join(filter(None, [source, os.environ.get('PYTHONPATH')]))

    def start(*arguments):
        started.append(subprocess.Popen(
            [sys.executable, '-m', 'track_before_detect.ros.demo', *map(str, arguments),
             '--output', str(tmp_path / 'out')],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, 'PYTHONPATH': path}))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=TIMEOUT_S)


def test_target_is_found_in_every_frame_and_drawn(start_demo, recording, tmp_path):
    demo = start_demo(recording, '--set', 'threshold=12')
    output, errors = demo.communicate(timeout=TIMEOUT_S)
    assert demo.returncode == 0, output + errors
    assert '30 of 30' in output, output
    assert 'note:' not in output, output
    assert (tmp_path / 'out' / 'overlay.png').read_bytes().startswith(b'\x89PNG')
    rows = (tmp_path / 'out' / 'trajectories.csv').read_text().splitlines()
    assert len(rows) >= 31


def test_nothing_found_ends_with_3(start_demo, recording, tmp_path):
    demo = start_demo(recording, '--set', 'threshold=1000')
    output, errors = demo.communicate(timeout=TIMEOUT_S)
    assert demo.returncode == 3, output + errors
    assert 'no trajectory found' in output
    assert '0 of 30' in output
    assert (tmp_path / 'out' / 'overlay.png').exists()


@pytest.mark.parametrize('arguments, sentence', [
    (['missing.npz'], 'missing.npz does not exist'),
    (['--set', 'psf_sigma_px=much'], 'psf_sigma_px must be a number'),
    (['--set', 'psf_sigma=1'], 'did you mean psf_sigma_px'),
    (['--rate', '0'], '--rate must be above 0'),
    (['--nonsense'], 'unrecognized arguments: --nonsense'),
], ids=['missing file', 'bad value', 'unknown option', 'bad rate', 'unknown argument'])
def test_bad_input_ends_with_2_and_one_sentence(start_demo, tmp_path, arguments, sentence):
    demo = start_demo(*arguments)
    output, errors = demo.communicate(timeout=TIMEOUT_S)
    assert demo.returncode == 2
    assert sentence in errors
    assert len(errors.splitlines()) == 1
    assert not output
    assert not (tmp_path / 'out').exists()


def test_interrupt_ends_the_nodes_too(start_demo, recording):
    # Slow enough that the interrupt comes while the recording is played.
    demo = start_demo(recording, '--set', 'threshold=1000', '--rate', '0.5')
    children = _wait_for_children(demo, 2)
    demo.send_signal(signal.SIGINT)
    _, errors = demo.communicate(timeout=TIMEOUT_S)
    assert demo.returncode == 0, errors
    assert 'interrupted' in errors
    assert 'Traceback' not in errors
    assert not any(Path(f'/proc/{child}').exists() for child in children)


def test_report_names_the_nearest_target_and_its_error():
    truth = np.array([[k, target, 10.0 + k, 20.0 + 30.0 * target]
                      for target in range(2) for k in range(10)])
    k = np.arange(4, 10)
    trajectory = Trajectory(
        id=7, positions=np.column_stack([10.0 + k, np.full(6, 50.5)]), amplitudes=np.ones(6),
        velocity=np.tile([25.0, 0.0], (6, 1)), stamps=k / 25.0, frame_indices=k, statistic=9.0,
        snr=3.0)
    lines = report([trajectory], truth).splitlines()
    assert lines[2].split() == [
        '7', '4-9', '14.0,', '50.5', '19.0,', '50.5', '25.00', '3.00', '1', '0.50']
    assert lines[-2].split()[-4:] == ['0', 'of', '10', '-']
    assert lines[-1].split()[-4:] == ['6', 'of', '10', '7']


def test_the_demo_tells_the_same_of_a_target_as_the_command():
    frames = np.random.default_rng(1).standard_normal((50, 24, 40)).astype(np.float32)
    for t in range(14, 50):
        add_target(frames[t], 5 + 0.5 * t, 12.0, 1.0, 7.0)
    stamps = 3.0 + np.arange(50) / 25
    options = DetectorOptions(threshold=9.0, batch_length=20)
    [expected] = tbd.detect(frames, stamps, threshold=9.0, batch_length=20).trajectories
    pipeline, sent = TrackingPipeline(options), []
    for first in range(0, 31, 10):
        rows = np.arange(first, first + 20)
        result = pipeline.process(FrameBatch(frames[rows], stamps[rows], rows))
        message = conversions.points_from_trajectories(result.trajectories, Header())
        sent.append((stamps[rows[-1]], conversions.points_to_array(message)))
    [shown] = joined_batches(sent, stamps, options)
    assert shown.id == expected.id
    assert shown.snr == pytest.approx(expected.snr, rel=1e-6)
    assert shown.statistic == pytest.approx(expected.statistic, rel=1e-6)
    np.testing.assert_allclose(shown.positions, expected.positions, atol=1e-4)
    np.testing.assert_allclose(shown.covariance, expected.covariance, rtol=1e-5, atol=1e-9)


def test_report_without_truth_shows_what_was_found():
    assert report([], None) == 'no trajectory found'


def _wait_for_children(process, count):
    """Return the ids of the processes that a process has started, once there are enough."""
    listed = Path(f'/proc/{process.pid}/task/{process.pid}/children')
    end_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end_s:
        assert process.poll() is None, process.communicate()
        children = listed.read_text().split()
        if len(children) >= count:
            return children
        time.sleep(0.05)
    raise AssertionError(f'{count} processes were not started within {TIMEOUT_S} s')
