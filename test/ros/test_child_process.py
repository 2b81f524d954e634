"""Processes end with the block that started them, whenever an interrupt comes."""

import os
import signal
import subprocess

import pytest

from track_before_detect.ros.demo import child_process
from track_before_detect.ros.demo.child_process import ChildProcess


def test_process_ends_with_its_block(tmp_path):
    with ChildProcess('sleeper', ['sleep', '60'], tmp_path / 'log') as child:
        child.start()
        assert child.exit_code is None
    assert child.exit_code == -signal.SIGINT


def test_block_that_starts_nothing_ends(tmp_path):
    with ChildProcess('sleeper', ['sleep', '60'], tmp_path / 'log'):
        pass


def test_interrupt_while_a_process_starts_leaves_none_behind(tmp_path, monkeypatch):
    started = []

    def interrupted(*arguments, start=subprocess.Popen, **settings):
        started.append(start(*arguments, **settings))
        os.kill(os.getpid(), signal.SIGINT)
        return started[0]

    monkeypatch.setattr(child_process.subprocess, 'Popen', interrupted)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        with ChildProcess('sleeper', ['sleep', '60'], tmp_path / 'log') as child:
            child.start()
    assert started[0].poll() is not None
    assert signal.getsignal(signal.SIGINT) is before
