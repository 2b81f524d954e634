"""Executable ``stitcher``."""

from typing import NoReturn

from track_before_detect.ros.executables.ending import Ending


def main(args: list[str] | None = None) -> NoReturn:
    """Run the node and end the process."""
    # Before what takes a second to import.
    ending = Ending()
    from track_before_detect.ros.executables.running import run, spin
    from track_before_detect.ros.stitching import stitcher_node
    run('stitcher', stitcher_node, stitcher_node.StitcherNode, spin, ending, args)


if __name__ == '__main__':
    main()
