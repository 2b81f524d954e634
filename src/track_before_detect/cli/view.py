"""``tbd view``: look at a search on rerun."""

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
from typing import Any
from urllib.parse import quote

from track_before_detect.atomic_files import atomic_path
from track_before_detect.cli.console import check_output_file, FOUND, NOTHING_FOUND, require_extra
from track_before_detect.cli.detect import add_input_arguments, search, told_options
from track_before_detect.errors import DataError
from track_before_detect.recordings.open_recording import expand_inputs
from track_before_detect.results.saved import is_result, Opened, read_result

HELP = 'look at a search in a window or a browser'
DESCRIPTION = (
    'Search a recording and show it along its time on rerun, while it is '
    'searched: frames with\ntrajectories, ids and truth, what is searched, the matched '
    'filter, and the strongest path\nof each batch beside the threshold. Of a folder of results, '
    'show the recording with the\ntrajectories that were found.')
EXAMPLES = """\
examples:
  in a window:
    tbd view flight.mp4
  in a browser, until Ctrl-C:
    tbd view flight.mp4 --web
  what tbd detect has found, without another search:
    tbd view output
  to look at later, with rerun flight.rrd:
    tbd view flight.mp4 --save flight.rrd
"""


# Within which the server has to answer.
_PATIENCE_S = 30.0


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    add_input_arguments(parser)
    either = parser.add_mutually_exclusive_group()
    either.add_argument('--save', metavar='FILE.rrd', help='write a file in place of a window')
    either.add_argument('--web', action='store_true',
                        help='serve a page and print its address, in place of a window')


def run(arguments: Namespace) -> int:
    """Search the recording and show it; return the exit code."""
    told = told_options(arguments)
    require_extra('rerun', 'view', 'tbd view')
    if arguments.save is not None:
        check_output_file(Path(arguments.save), '.rrd')
    if len(paths := expand_inputs(arguments.inputs)) > 1:
        raise DataError(f'tbd view takes one input, got {len(paths)}')
    import rerun

    from track_before_detect.inspection.live_view import LiveView

    stream = rerun.RecordingStream('track_before_detect')
    found = read_result(paths[0]) if is_result(paths[0]) else None
    source = Opened(paths[0], arguments.topic, arguments.fps) if found is None else found[0]
    with ExitStack() as opened:
        recording = opened.enter_context(source.open())
        if arguments.save is not None:
            stream.save(opened.enter_context(atomic_path(arguments.save)))
        elif arguments.web:
            opened.enter_context(_served(stream))
        else:
            stream.spawn()
        view = LiveView(recording, stream)
        if found is None:
            trajectories = search(recording, arguments, told, observe=view)[0].trajectories
        else:
            view.show_frames()
            trajectories = found[1]
        view.show_trajectories(trajectories)
        stream.flush()
        if arguments.save is not None:
            stream.disconnect()
        print(f'{recording.name}: {len(trajectories)} trajectories', flush=True)
        while arguments.web:
            time.sleep(1)
    if arguments.save is not None:
        print(f'written: {arguments.save}')
    return FOUND if trajectories else NOTHING_FOUND


@contextmanager
def _served(stream: Any) -> Iterator[None]:
    """Serve what is shown as a page that this machine alone can reach, and print its address."""
    ports = [_free_port() for _ in range(2)]
    source = f'rerun+http://127.0.0.1:{ports[0]}/proxy'
    # Its server within a process listens to the whole network; this one is told where.
    server = subprocess.Popen(
        [sys.executable, '-m', 'rerun', '--serve-web', '--bind', '127.0.0.1', '--port',
         str(ports[0]), '--web-viewer-port', str(ports[1])],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        until = time.monotonic() + _PATIENCE_S
        while not all(map(_listens, ports)):
            if server.poll() is not None or time.monotonic() > until:
                raise DataError('the server of rerun has not started: python -m rerun --serve-web '
                                'says why')
            time.sleep(0.1)
        stream.connect_grpc(source)
        print(f'http://127.0.0.1:{ports[1]}?url={quote(source, safe="")} until Ctrl-C', flush=True)
        yield
    finally:
        os.killpg(server.pid, signal.SIGTERM)
        server.wait()


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(('127.0.0.1', 0))
        return one.getsockname()[1]


def _listens(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(('127.0.0.1', port)) == 0
