"""Play a recording or a simulated scenario to the detector."""

from launch import LaunchDescription
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from track_before_detect.ros.executables.launching import argument, included, installed


def generate_launch_description() -> LaunchDescription:
    """Return the frame publisher and the detector, and RViz when asked for."""
    return LaunchDescription([
        argument('loop', 'true', 'Whether to play it again and again.'),
        argument('detector_params_file', installed('config', 'detector.param.yaml'),
                 'Parameters of the detector.'),
        argument('rviz', 'false', 'Whether to show it in RViz.'),
        included('frame_publisher'),
        included('detector', launch_arguments=[
            ('params_file', LaunchConfiguration('detector_params_file'))]),
        included('view', condition=IfCondition(LaunchConfiguration('rviz'))),
    ])
