"""Start a detector that searches the frames of several sensors together."""

from launch import LaunchDescription
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from track_before_detect.ros.executables.launching import argument, included


def generate_launch_description() -> LaunchDescription:
    """Return the detector with a file that names its sensors, and RViz when asked for."""
    return LaunchDescription([
        argument('params_file', None, 'Parameters of the detector: its sensors, their topics and '
                 'how each sees the common plane.'),
        argument('rviz', 'false', 'Whether to show it in RViz.'),
        included('detector'),
        included('view', condition=IfCondition(LaunchConfiguration('rviz'))),
    ])
