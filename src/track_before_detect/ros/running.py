"""Start a node, spin it, and leave without a traceback."""

from collections.abc import Callable
import signal
import sys
from typing import TypeVar

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.utilities import try_shutdown

from track_before_detect.errors import TbdError
from track_before_detect.ros.logs.log_folder import ensure_log_folder

EXIT_DONE = 0
EXIT_BAD_INPUT = 2

AnyNode = TypeVar('AnyNode', bound=Node)


def run(name: str, make_node: Callable[[], AnyNode], spin: Callable[[AnyNode], None],
        args: list[str] | None = None) -> int:
    """Run a node until it is done or interrupted.

    Parameters
    ----------
    name : str
        For the sentence on stderr when it cannot start.
    make_node : callable
        Returns the node; raises TbdError when a parameter or an input cannot be used.
    spin : callable
        Takes the node and returns when it is done.
    args : list of str, optional
        Command line; that of the process by default.

    Returns
    -------
    int
        0 when done or interrupted, 2 when a parameter or an input cannot be used.
    """
    node = None
    try:
        note = ensure_log_folder()
        _init(args)
        node = make_node()
        if note:
            node.get_logger().warning(note)
        spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (TbdError, ParameterException) as error:
        print(f'{name}: error: {error}', file=sys.stderr)
        return EXIT_BAD_INPUT
    except RuntimeError:
        # A signal shuts the context down from a thread of rclpy's own. When that falls between
        # the executor's check of the context and its use of it, the error is rcl's and not
        # ExternalShutdownException.
        if rclpy.ok():
            raise
    finally:
        # Under ros2 launch the interrupt arrives twice; the second one must not cut this short.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return EXIT_DONE


def _init(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args)
    except RuntimeError as error:
        # What follows names lines of the source of rcl.
        reason = str(error).splitlines()[0].split(', at /')[0]
        raise TbdError(f'the ROS arguments cannot be used: {reason}') from error
