"""Executable ``detector``."""

from typing import NoReturn

from track_before_detect.ros.executables.ending import Ending


def main(args: list[str] | None = None) -> NoReturn:
    """Run the node and end the process."""
    # Before what takes a second to import.
    ending = Ending()
    from track_before_detect.ros import detector_node
    from track_before_detect.ros.executables.running import run, spin
    run('detector', detector_node, detector_node.DetectorNode, spin, ending, args)


if __name__ == '__main__':
    main()
