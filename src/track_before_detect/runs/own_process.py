"""A measurement in a process of its own, so that its peak memory is its own."""

from collections.abc import Callable
import multiprocessing
from multiprocessing.connection import Connection
import resource
import signal
import sys
from typing import Any

from track_before_detect.errors import DataError


def in_own_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function returns in a new process, which ends with it."""
    context = multiprocessing.get_context('spawn')
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send_result, args=(sender, function, arguments),
                              daemon=True)
    process.start()
    sender.close()
    try:
        succeeded, outcome = receiver.recv()
    except EOFError:
        process.join()
        raise DataError(
            f'a measurement was ended by the system (exit code {process.exitcode}), as it does '
            'when memory runs out') from None
    finally:
        process.terminate()
        process.join()
    if not succeeded:
        raise outcome
    return outcome


def peak_memory(used: resource.struct_rusage | None = None) -> int:
    """Return the largest resident memory of this process so far, or of what is told, in bytes."""
    peak = (used or resource.getrusage(resource.RUSAGE_SELF)).ru_maxrss
    return peak if sys.platform == 'darwin' else 1024 * peak


def _send_result(sender: Connection, function: Callable[..., Any],
                 arguments: tuple[Any, ...]) -> None:
    """Call a function and send what it returns or raises."""
    # An interruption reaches the whole group; the parent ends this process then.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        sender.send((True, function(*arguments)))
    except Exception as error:  # handed on to the parent, which raises it
        sender.send((False, error))
