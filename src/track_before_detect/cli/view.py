"""``tbd view``: look at a search on rerun."""

from argparse import Namespace
from contextlib import ExitStack
from pathlib import Path
import time
from typing import Any

from track_before_detect.atomic_files import atomic_path
from track_before_detect.cli.console import check_output_file, FOUND, NOTHING_FOUND, require_extra
from track_before_detect.cli.detect import add_input_arguments, search, told_options
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.recordings.open_recording import expand_inputs
from track_before_detect.results.saved import is_result, Opened, read_result

# The arguments that decide how a recording is read and searched.
_OF_A_SEARCH = ('detector', 'config', 'preset', 'set', 'topic', 'fps')

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


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    add_input_arguments(parser)
    either = parser.add_mutually_exclusive_group()
    either.add_argument('--save', metavar='FILE.rrd', help='write a file in place of a window')
    either.add_argument('--web', action='store_true',
                        help='serve a page and print its address, in place of a window')


def run(arguments: Namespace) -> int:
    """Search the recording and show it; return the exit code."""
    of_a_search = [f'--{name}' for name in _OF_A_SEARCH
                   if getattr(arguments, name) not in (None, [])]
    told = told_options(arguments)
    require_extra('rerun', 'view', 'tbd view')
    if arguments.save is not None:
        check_output_file(Path(arguments.save), '.rrd', name='--save')
    if len(paths := expand_inputs(arguments.inputs)) > 1:
        raise DataError(f'tbd view takes one input, got {len(paths)}')
    if of_a_search and is_result(paths[0]):
        raise ParameterError(
            f'{paths[0]} is a result, which is shown as it was found: {" and ".join(of_a_search)} '
            'must be left out, or the recording given')
    from track_before_detect.inspection.live_view import LiveView
    from track_before_detect.inspection.view_outlets import new_stream, saved, served

    stream = new_stream()
    found = read_result(paths[0]) if is_result(paths[0]) else None
    source = Opened(paths[0], arguments.topic, arguments.fps) if found is None else found[0]
    with ExitStack() as opened:
        recording = opened.enter_context(source.open())
        if arguments.save is not None:
            partial = opened.enter_context(atomic_path(arguments.save))
            opened.enter_context(saved(stream, partial))
        elif arguments.web:
            print(f'{opened.enter_context(served(stream))} until Ctrl-C', flush=True)
        else:
            stream.spawn()
        view = LiveView(stream, recording.truth)
        if found is None:
            trajectories = search(recording, arguments, told, observe=view)[0].trajectories
        else:
            view.show_frames(recording)
            trajectories = found[1]
        view.show_trajectories(trajectories, range(len(recording)), recording.stamps)
        stream.flush()
        print(f'{recording.name}: {len(trajectories)} trajectories', flush=True)
        while arguments.web:
            time.sleep(1)
    if arguments.save is not None:
        print(f'written: {arguments.save}')
    return FOUND if trajectories else NOTHING_FOUND
