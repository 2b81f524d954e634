"""Nodes as copies of one process that has imported what they need, which takes a second of each.

A copy runs the executable as ``python -m`` does, as a process of its own with its own arguments
and output. Only where the environment is that of the first process: some of it is read on import.
"""

import multiprocessing
import os
import runpy
import signal
import subprocess
import sys

EXECUTABLES = 'track_before_detect.ros.executables'
IMPORTED = [__name__, *(f'track_before_detect.ros.{name}' for name in (
    'detector_node', 'frame_publisher_node', 'recorder.recorder_node',
    'stitching.stitcher_node', 'executables.running'))]
_context = multiprocessing.get_context('forkserver')
_environment = {}


def _run(module, arguments, folder, output):
    """Be the process of an executable."""
    os.chdir(folder)
    for number in (1, 2):
        os.dup2(output.fileno(), number)
    output.close()
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name='__main__', alter_sys=True)


def _today():
    return {name: value for name, value in os.environ.items() if name != 'PYTEST_CURRENT_TEST'}


def can_be_copied():
    """Return whether a copy would find the environment that a new process would."""
    if not _environment:
        _environment.update(_today())
        _context.set_forkserver_preload(IMPORTED)
    return _environment == _today()


class Copy:
    """A process with what the tests use of ``subprocess.Popen``."""

    def __init__(self, executable, arguments):
        reader, writer = _context.Pipe(duplex=False)
        self._process = _context.Process(
            target=_run, daemon=True,
            args=(f'{EXECUTABLES}.{executable}', arguments, os.getcwd(), writer))
        self._process.start()
        writer.close()
        self.pid = self._process.pid
        self.stdout = os.fdopen(os.dup(reader.fileno()))
        reader.close()

    @property
    def returncode(self):
        return self._process.exitcode

    def poll(self):
        return self._process.exitcode

    def wait(self, timeout_s=None):
        self._process.join(timeout_s)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout_s)
        return self._process.exitcode

    def send_signal(self, number):
        if self._process.exitcode is None:
            os.kill(self.pid, number)

    def kill(self):
        self.send_signal(signal.SIGKILL)
