"""Merge what several detectors find, each in its region of one stream."""

from launch import LaunchDescription

from track_before_detect.ros.executables.launching import node


def generate_launch_description() -> LaunchDescription:
    """Return the stitcher with its parameters."""
    return LaunchDescription(node('stitcher', 'stitcher_params_file', {}))
