"""SIGINT and SIGTERM end every executable in time, whatever it is doing."""

import itertools
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip('rclpy')

from track_before_detect.kernels.compiled_cache import cache_folder  # noqa: E402

TIMEOUT_S = 60.0
LONGEST_S = 2.0
SIGNALS = itertools.cycle([signal.SIGINT, signal.SIGTERM])


def start(name, *arguments, folder):
    """Start an executable in a process of its own."""
    output = open(folder / f'{name}.log', 'ab')
    process = subprocess.Popen(
        [sys.executable, '-m', f'track_before_detect.ros.{name}', *arguments], stdout=output,
        stderr=output, cwd=folder)
    output.close()
    return process


def wait_until_it_handles_signals(process):
    """Wait until it is our code that is told of SIGTERM; before, it is Python that starts."""
    end_s = time.monotonic() + TIMEOUT_S
    status = Path(f'/proc/{process.pid}/status')
    while time.monotonic() < end_s:
        [caught] = [line for line in status.read_text().splitlines() if 'SigCgt' in line]
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.002)
    raise AssertionError(f'no handler within {TIMEOUT_S} s')


def end(process, *numbers):
    """Send signals, one soon after the other; return the seconds until the end."""
    began_s = time.monotonic()
    for number in numbers:
        process.send_signal(number)
        time.sleep(0.05)
    process.wait(TIMEOUT_S)
    return time.monotonic() - began_s


@pytest.mark.parametrize('name', [
    'executables.detector', 'executables.frame_publisher', 'executables.recorder', 'demo'])
def test_signals_at_any_time_after_the_start_end_it_in_time_without_a_traceback(
        ros_domain, tmp_path, name):
    for delay_s in (0.0, 0.4, 0.8, 1.6):
        process = start(name, folder=tmp_path)
        wait_until_it_handles_signals(process)
        time.sleep(delay_s)
        number = next(SIGNALS)
        assert end(process, number, number) < LONGEST_S, delay_s
        words = (tmp_path / f'{name}.log').read_text()
        assert process.returncode == 0, (delay_s, words)
        assert 'Traceback' not in words and 'rror' not in words, (delay_s, words)


@pytest.mark.parametrize('doing', ['compiling', 'calibrating'])
def test_a_signal_ends_a_preparation(launch, tmp_path, monkeypatch, doing):
    # No threshold is in the cache or known by the model; loops are only where they are not what is
    # waited for.
    if doing == 'calibrating':
        loops = tmp_path / 'track_before_detect' / 'loops'
        loops.parent.mkdir()
        loops.symlink_to(cache_folder())
        monkeypatch.delenv('NUMBA_CACHE_DIR', raising=False)
    else:
        monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    detector = launch('detector', '-p', 'frame_height:=256', '-p', 'frame_width:=320', '-p',
                      'frame_rate_hz:=10.0', '-p', 'preset:=none', '-p',
                      'motion_model:=range_bearing')
    detector.wait_for_line(doing)
    time.sleep(0.2)
    assert end(detector.process, signal.SIGINT, signal.SIGINT) < LONGEST_S
    assert detector.wait() == 0
    assert 'Traceback' not in detector.output and 'rror' not in detector.output


@pytest.mark.parametrize('name', ['detector', 'frame_publisher'])
def test_help_names_topics_and_parameters(name):
    done = subprocess.run(
        [sys.executable, '-m', f'track_before_detect.ros.executables.{name}', '--help'],
        capture_output=True, text=True, timeout=TIMEOUT_S)
    assert done.returncode == 0 and not done.stderr
    assert done.stdout.startswith(f'usage: {name} [--help] [--ros-args')
    parameter = {'detector': 'frame_height (0):', 'frame_publisher': 'rate_hz (0.0):'}[name]
    assert parameter in done.stdout and '(relative)' in done.stdout
