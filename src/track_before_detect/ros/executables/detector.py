"""Executable ``detector``."""

import sys

from track_before_detect.ros.executables.ending import Ending


def main(args: list[str] | None = None) -> int:
    """Run the node and return the exit code."""
    # Before what takes a second to import.
    ending = Ending()
    from track_before_detect.ros import detector_node
    from track_before_detect.ros.executables.running import run, spin
    return run('detector', detector_node, detector_node.DetectorNode, spin, ending, args)


if __name__ == '__main__':
    sys.exit(main())
