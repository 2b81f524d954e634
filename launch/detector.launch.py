"""Start the detector."""

from launch import LaunchDescription

from track_before_detect.ros.executables.launching import node


def generate_launch_description() -> LaunchDescription:
    """Return the detector with its parameters and the remapping of its inputs."""
    return LaunchDescription(node('detector', 'params_file', {
        'use_sim_time': ('false', bool, 'Whether to follow /clock, as for a bag played with '
                         '--clock.'),
        'autostart': ('true', bool, 'Whether the node configures and activates itself.'),
    }, ('image', 'frame')))
