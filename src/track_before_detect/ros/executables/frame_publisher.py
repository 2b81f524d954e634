"""Executable ``frame_publisher``."""

from typing import NoReturn

from track_before_detect.ros.executables.ending import Ending


def main(args: list[str] | None = None) -> NoReturn:
    """Run the node and end the process."""
    # Before what takes a second to import.
    ending = Ending()
    from track_before_detect.ros import frame_publisher_node
    from track_before_detect.ros.executables.running import run
    run('frame_publisher', frame_publisher_node, frame_publisher_node.FramePublisherNode,
        frame_publisher_node.play, ending, args)


if __name__ == '__main__':
    main()
