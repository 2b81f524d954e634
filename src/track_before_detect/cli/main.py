"""Where the command ``tbd`` begins and ends."""

from collections.abc import Sequence
import io
import logging
import os
import signal
import sys
import threading
from typing import NoReturn

from track_before_detect import __version__
from track_before_detect.cli import (
    bench,
    calibrate,
    config,
    detect,
    doctor,
    evaluate,
    inspect,
    plan,
    simulate,
    view,
    warm_up,
)
from track_before_detect.cli.arguments.completion import PrintCompletion, SHELLS
from track_before_detect.cli.console import (
    add_loudness,
    BAD_INPUT,
    error_words,
    fail,
    FOUND,
    INTERRUPTED,
    Parser,
    TERMINATED,
)
from track_before_detect.errors import TbdError
from track_before_detect.parallel import exit_at_once_is_needed

_EXAMPLES = """\
try it:
  tbd simulate eo_ir_drones --seed 1 --output drones.npz
  tbd detect drones.npz --output drones

completion in bash, now and later (needs the extra completion):
  eval "$(tbd --print-completion bash)"

exit codes:
  0  done and something found (or nothing to find)
  2  an input or option cannot be used; one sentence on stderr says why (of several inputs, the
     others are searched all the same; where a picture or film cannot be made of what was found,
     the tables are written all the same)
  3  done and nothing found
  130  interrupted with Ctrl-C
  143  ended by the signal TERM
"""
# Each has HELP, DESCRIPTION and EXAMPLES, and functions add_arguments and run.
_COMMANDS = {
    'detect': detect, 'plan': plan, 'view': view, 'inspect': inspect, 'simulate': simulate,
    'evaluate': evaluate, 'calibrate': calibrate, 'bench': bench, 'warm-up': warm_up,
    'config': config, 'doctor': doctor}
_LOG = logging.getLogger(__name__)
_OURS = logging.getLogger(__name__.partition('.')[0])


class _Terminated(SystemExit):
    """The signal TERM has come."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    logging.basicConfig(format='tbd: %(levelname)s: %(message)s', level=logging.WARNING)
    # Whoever called goes on as before.
    level = _OURS.level
    _prepare_output()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminate)
    try:
        return _ended(arguments)
    finally:
        _OURS.setLevel(level)


def _ended(arguments: Sequence[str] | None) -> int:
    """Run the command and return its exit code, in whichever way it ends."""
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output, such as head, has seen enough; closing must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FOUND
    except KeyboardInterrupt:
        print('tbd: interrupted', file=sys.stderr, flush=True)
        return _leave(INTERRUPTED)
    except _Terminated:
        return _leave(TERMINATED)
    except (TbdError, OSError, MemoryError) as error:
        _LOG.debug('where it comes from:', exc_info=error)
        return fail('tbd', error_words(error))


def _prepare_output() -> None:
    """Let nothing that is printed fail for want of a stream or of a character."""
    for name in ('stdout', 'stderr'):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, 'w', encoding='utf-8'))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


def _terminate(*_: object) -> NoReturn:
    """End like an error does, so that no half-written file stays."""
    raise _Terminated


def _leave(code: int) -> int:
    """Return an exit code, or end with it where Python could not be left the usual way."""
    if exit_at_once_is_needed():
        os._exit(code)
    return code


def _run(arguments: Sequence[str] | None) -> int:
    parser = Parser(
        prog='tbd', epilog=_EXAMPLES,
        description='Find dim moving targets in sequences of frames where no single frame shows '
        'them\n(track-before-detect).')
    parser.add_argument('--version', action='version', version=f'tbd {__version__}')
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title='commands', metavar='COMMAND')
    for name, command in _COMMANDS.items():
        command_parser = commands.add_parser(
            name, help=command.HELP, description=command.DESCRIPTION, epilog=command.EXAMPLES)
        command_parser.set_defaults(run=command.run)
        command.add_arguments(command_parser)
        add_loudness(command_parser)
    parser.add_argument('--print-completion', metavar='SHELL', action=PrintCompletion,
                        choices=SHELLS, help='print what lets a shell complete commands and '
                        f'options: {", ".join(SHELLS)}')
    options = parser.parse_args(arguments)
    if options.run is None:
        parser.print_help()
        return BAD_INPUT
    # We say how much memory a search is going to take.
    _OURS.setLevel(logging.DEBUG if options.verbose else
                   logging.WARNING if options.quiet else logging.INFO)
    return options.run(options)
