"""Let two detectors share one wide stream, each with its region, and merge what they find."""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration

from track_before_detect.ros.executables.launching import argument, included, installed


def generate_launch_description() -> LaunchDescription:
    """Return a detector in each of the namespaces left and right, and the stitcher."""
    return LaunchDescription([
        argument('regions_params_file', installed('config', 'regions.yaml'),
                 'Parameters of /left/detector, /right/detector and /stitcher.'),
        # A relative name would be another topic for each of them.
        argument('image', '/image', 'Topic of the whole frames, beginning with a slash.'),
        argument('frame', '/frame', 'The same for arrays of numbers.'),
        *[included(node, launch_arguments=[
            (f'{prefix}params_file', LaunchConfiguration('regions_params_file')),
            ('namespace', namespace)])
          for node, prefix, namespace in (
              ('detector', '', 'left'), ('detector', '', 'right'), ('stitcher', 'stitcher_', ''))],
    ])
