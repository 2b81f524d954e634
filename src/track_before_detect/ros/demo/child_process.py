"""Run a node as a process of its own and end it cleanly."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import signal
import subprocess

STOP_TIMEOUT_S = 10.0
# A node that ended by our interrupt has done nothing wrong.
INTERRUPTED_CODES = (0, 130, -signal.SIGINT)


class ChildProcess:
    """A process whose output goes to a file; ends with the ``with`` block at the latest.

    Parameters
    ----------
    name : str
        What messages call it.
    command : sequence of str
        Program and arguments.
    log : path
        File that receives its output, replaced when it exists.
    environment : mapping, optional
        Variables that differ from those of this process.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path,
                 environment: dict[str, str] | None = None):
        self.name = name
        self.log = log
        self._command = list(command)
        self._environment = environment or {}
        self._process: subprocess.Popen | None = None

    def __enter__(self) -> ChildProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self.stop()

    def start(self) -> None:
        """Start the process, within the ``with`` block."""
        with open(self.log, 'wb') as output:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                env={**os.environ, **self._environment})

    @property
    def pid(self) -> int:
        """Number of the process."""
        assert self._process is not None
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code, None while it runs."""
        assert self._process is not None
        return self._process.poll()

    def interrupt(self) -> None:
        """Interrupt the process if it still runs."""
        assert self._process is not None
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def stop(self, timeout_s: float = STOP_TIMEOUT_S) -> bool:
        """Interrupt the process, kill it when it takes too long; return whether it ended well."""
        assert self._process is not None
        self.interrupt()
        try:
            return self._process.wait(timeout_s) in INTERRUPTED_CODES
        except subprocess.TimeoutExpired:
            return False
        finally:
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()

    def last_lines(self, count: int) -> list[str]:
        """Return the last lines it wrote that are not empty."""
        text = self.log.read_text(encoding='utf-8', errors='replace')
        return [line for line in text.splitlines() if line.strip()][-count:]
