"""Executable ``recorder``."""

from typing import NoReturn

from track_before_detect.ros.executables.ending import Ending


def main(args: list[str] | None = None) -> NoReturn:
    """Run the node and end the process."""
    # Before what takes a second to import.
    ending = Ending()
    from track_before_detect.ros.executables.running import run, spin
    from track_before_detect.ros.recorder import recorder_node
    run('recorder', recorder_node, recorder_node.RecorderNode, spin, ending, args)


if __name__ == '__main__':
    main()
