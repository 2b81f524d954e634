"""Play a recording or a simulated scenario."""

from launch import LaunchDescription

from track_before_detect.ros.executables.launching import node


def generate_launch_description() -> LaunchDescription:
    """Return the frame publisher with the parameters that are given most often."""
    return LaunchDescription(node('frame_publisher', 'publisher_params_file', {
        'input': ('', str, 'Recording to play; empty plays the scenario.'),
        'topic': ('', str, 'Topic of a bag; empty takes the only suitable one.'),
        'scenario': ('eo_ir_drones', str, 'Simulated scenario.'),
        'scenario_set': ('', str, 'Parameters of the scenario to change, KEY=VALUE.'),
        'rate': ('1.0', float, 'How many times faster than that it is played.'),
        'rate_hz': ('0.0', float, 'Frames per second; 0 keeps the original intervals.'),
        'loop': ('false', bool, 'Whether to play it again and again.'),
        'start_offset_s': ('0.0', float, 'Where playing starts, in seconds.'),
        'start_paused': ('false', bool, 'Whether to wait for ~/resume or ~/play_next.'),
        'original_stamps': ('false', bool, 'Whether frames keep the stamps of the recording.'),
        'clock_hz': ('0.0', float, 'How often /clock is published; 0 is never.'),
    }))
