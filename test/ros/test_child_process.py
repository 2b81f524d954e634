"""Processes end with the block that started them, whenever an interrupt comes."""

import signal

from track_before_detect.ros.demo.child_process import ChildProcess


def test_process_ends_with_its_block(tmp_path):
    with ChildProcess('sleeper', ['sleep', '60'], tmp_path / 'log') as child:
        child.start()
        assert child.exit_code is None
    assert child.exit_code == -signal.SIGINT


def test_block_that_starts_nothing_ends(tmp_path):
    with ChildProcess('sleeper', ['sleep', '60'], tmp_path / 'log'):
        pass
