"""Where ``python -m track_before_detect.ros.demo`` begins and ends."""

from track_before_detect.ros.executables.ending import Ending

if __name__ == '__main__':
    # Before what takes a second to import. The nodes, which are told a little later, end first.
    ending = Ending(grace_s=1.85)
    from track_before_detect.ros.demo.play import main
    main(ending)
