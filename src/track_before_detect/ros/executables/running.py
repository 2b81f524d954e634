"""Start a node, spin it, and leave without a traceback."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
import textwrap
from typing import NoReturn, Protocol, TypeVar

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown

from track_before_detect.cli.console import Parser
from track_before_detect.errors import TbdError
from track_before_detect.ros.executables.ending import Ending
from track_before_detect.ros.logs.log_folder import ensure_log_folder
from track_before_detect.ros.parameters import NodeParameter

EXIT_DONE = 0
EXIT_BAD_INPUT = 2

RCLError = rclpy_implementation.RCLError
ARGUMENTS = 'the ROS arguments cannot be used'

AnyNode = TypeVar('AnyNode', bound=Node)
# Spins a node until it is done or a signal has come.
Spin = Callable[[AnyNode, SingleThreadedExecutor, Ending], None]


class NodeModule(Protocol):
    """What is asked of the module of a node for its help."""

    __doc__: str | None
    PARAMETERS: list[NodeParameter]


def run(name: str, module: NodeModule, make_node: Callable[[], AnyNode], spin: Spin[AnyNode],
        ending: Ending, args: list[str] | None = None) -> NoReturn:
    """Run a node until it is done or interrupted, and end the process.

    The exit code is 0 when done or interrupted, 2 when a parameter or an input cannot be used.

    Parameters
    ----------
    name : str
        For the help, and for the sentence on stderr when the node cannot start.
    module : module
        Whose docstring and parameters are the help.
    make_node : callable
        Returns the node; raises TbdError when a parameter or an input cannot be used.
    spin : callable
        Takes node, executor and ``ending``, and returns when the node is done.
    ending : Ending
        Tells when a signal has come.
    args : list of str, optional
        Command line; that of the process by default.
    """
    node, code = None, EXIT_DONE
    ending.hold()
    try:
        with _words_of_rcl(ARGUMENTS):
            others = remove_ros_args(args)[1:]
        _parser(name, module).parse_args(others)
        note = ensure_log_folder()
        with _words_of_rcl(ARGUMENTS):
            # Its own handlers take the middleware away while it is used.
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        with _words_of_rcl('the node cannot be created', RCLError):
            node = make_node()
        if note:
            node.get_logger().warning(note)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # A callback of its own, so that the executor comes back at once.
        ending.hold(node.create_guard_condition(lambda: None).trigger)
        spin(node, executor, ending)
    except ExternalShutdownException:
        pass
    except (TbdError, ParameterException) as error:
        print(f'{name}: error: {error}', file=sys.stderr)
        code = EXIT_BAD_INPUT
    finally:
        if node is not None:
            node.destroy_node()
        try_shutdown()
    ending.leave(code)


def spin(node: Node, executor: SingleThreadedExecutor, ending: Ending) -> None:
    """Spin a node until a signal has come."""
    while not ending.requested:
        executor.spin_once()


@contextmanager
def _words_of_rcl(what: str, kind: type[Exception] = RuntimeError) -> Iterator[None]:
    """Raise TbdError that says ``what`` is wrong, and why, for an error of rcl."""
    try:
        yield
    except kind as error:
        # What follows names lines of the source of rcl.
        reason = str(error).splitlines()[0].split(', at /')[0]
        raise TbdError(f'{what}: {reason}') from error


def _parser(name: str, module: NodeModule) -> Parser:
    """Return the parser of what is no argument of ROS: a request for help."""
    lines = [
        textwrap.fill(f'{parameter.name} ({parameter.default!r}): {parameter.description}', 95,
                      initial_indent='  ', subsequent_indent='      ', break_on_hyphens=False)
        for parameter in module.PARAMETERS]
    return Parser(
        prog=name, description=module.__doc__,
        usage=f'{name} [--help] [--ros-args [-p PARAMETER:=VALUE] [-r FROM:=TO] '
        '[--params-file FILE] ...]',
        epilog='\n'.join(['parameters, with their defaults:', *lines]))
