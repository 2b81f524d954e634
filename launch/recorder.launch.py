"""Record frames and results to an MCAP file."""

from launch import LaunchDescription

from track_before_detect.ros.executables.launching import node


def generate_launch_description() -> LaunchDescription:
    """Return the recorder with its parameters and the remapping of the frames."""
    return LaunchDescription(node('recorder', 'recorder_params_file', {
        'output': ('', str, 'File to write, which ends with .mcap; empty names it after the '
                   'time.'),
    }, ('image', 'frame')))
