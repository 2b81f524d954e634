"""Play a recording to the detector as it was: with its stamps, and a clock that follows them."""

from launch import LaunchDescription
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution

from track_before_detect.ros.executables.launching import argument, included


def generate_launch_description() -> LaunchDescription:
    """Return what the demo has, and a recorder when asked for."""
    return LaunchDescription([
        argument('input', None, 'Recording to play.'),
        argument('loop', 'false', 'Whether to play it again and again.'),
        argument('original_stamps', 'true', 'Whether frames keep the stamps of the recording.'),
        argument('clock_hz', '100.0', 'How often /clock is published; 0 is never.'),
        argument('use_sim_time', 'true', 'Whether to follow /clock.'),
        argument('record', '', 'File to record to, which ends with .mcap; empty records '
                 'nothing.'),
        included('recorder', launch_arguments=[('output', LaunchConfiguration('record'))],
                 condition=IfCondition(NotEqualsSubstitution(LaunchConfiguration('record'), ''))),
        included('demo'),
    ])
