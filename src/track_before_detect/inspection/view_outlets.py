"""Where a view on rerun goes: a page that this machine alone can reach, or a file."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
from typing import Any
from urllib.parse import quote
from uuid import uuid4

from track_before_detect.errors import DataError

# Within which the server has to answer.
_PATIENCE_S = 30.0
# Its server within a process listens to the whole network; one of its own is told where. It is the
# first child of a shell that ends with it, or with this process, however that ends.
_UNTIL_LEFT = '("$@"; kill 0) & read -r _; kill 0'


def new_stream() -> Any:
    """Return a stream of rerun, a recording of its own."""
    import rerun

    return rerun.RecordingStream('track_before_detect', recording_id=uuid4())


@contextmanager
def served(stream: Any) -> Iterator[str]:
    """Serve what is shown as a page that this machine alone can reach; yield its address.

    Raises
    ------
    DataError
        When the server does not start.
    """
    ports = [_free_port() for _ in range(2)]
    source = f'rerun+http://127.0.0.1:{ports[0]}/proxy'
    server = subprocess.Popen(
        ['sh', '-c', _UNTIL_LEFT, 'sh', sys.executable, '-m', 'rerun', '--serve-web', '--bind',
         '127.0.0.1', '--port', str(ports[0]), '--web-viewer-port', str(ports[1])],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True)
    try:
        until = time.monotonic() + _PATIENCE_S
        while not all(map(_listens, ports)):
            if server.poll() is not None or time.monotonic() > until:
                raise DataError('the server of rerun has not started: python -m rerun --serve-web '
                                'says why')
            time.sleep(0.1)
        stream.connect_grpc(source)
        yield f'http://127.0.0.1:{ports[1]}?url={quote(source, safe="")}'
    finally:
        stream.disconnect()
        if server.poll() is None:
            os.killpg(server.pid, signal.SIGTERM)
        server.communicate()


@contextmanager
def saved(stream: Any, path: Path) -> Iterator[None]:
    """Write what is shown to a file."""
    stream.save(path)
    try:
        yield
    finally:
        stream.flush()
        stream.disconnect()


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(('127.0.0.1', 0))
        return one.getsockname()[1]


def _listens(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(('127.0.0.1', port)) == 0
