"""Executable ``frame_publisher``."""

import sys

from track_before_detect.ros.executables.ending import Ending


def main(args: list[str] | None = None) -> int:
    """Run the node and return the exit code."""
    # Before what takes a second to import.
    ending = Ending()
    from track_before_detect.ros import frame_publisher_node
    from track_before_detect.ros.executables.running import run
    return run('frame_publisher', frame_publisher_node, frame_publisher_node.FramePublisherNode,
               frame_publisher_node.play, ending, args)


if __name__ == '__main__':
    sys.exit(main())
