"""Play a recording or a simulated scenario to the detector."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the frame publisher and the detector."""
    config = [FindPackageShare('track_before_detect'), 'config']
    namespace = LaunchConfiguration('namespace')
    # Received frames are large blocks, which the allocator shall keep.
    environment = {
        'FASTRTPS_DEFAULT_PROFILES_FILE': LaunchConfiguration('fastdds_profile'),
        'MALLOC_MMAP_THRESHOLD_': '1073741824',
        'MALLOC_TRIM_THRESHOLD_': '1073741824',
    }
    return LaunchDescription([
        DeclareLaunchArgument(
            'input', default_value='',
            description='Recording to play; empty plays the scenario.'),
        DeclareLaunchArgument(
            'scenario', default_value='eo_ir_drones', description='Simulated scenario.'),
        DeclareLaunchArgument(
            'loop', default_value='true', description='Whether to play it again and again.'),
        DeclareLaunchArgument(
            'rate_hz', default_value='0.0',
            description='Frames per second; 0 keeps the original intervals.'),
        DeclareLaunchArgument(
            'detector_params_file',
            default_value=PathJoinSubstitution([*config, 'detector.param.yaml']),
            description='Parameters of the detector.'),
        DeclareLaunchArgument(
            'publisher_params_file',
            default_value=PathJoinSubstitution([*config, 'frame_publisher.param.yaml']),
            description='Parameters of the frame publisher.'),
        DeclareLaunchArgument(
            'namespace', default_value='', description='Namespace of the nodes and topics.'),
        DeclareLaunchArgument(
            'fastdds_profile', default_value=EnvironmentVariable(
                'FASTRTPS_DEFAULT_PROFILES_FILE', default_value=PathJoinSubstitution(
                    [*config, 'fastdds_profile.xml'])),
            description='Profile of Fast DDS; the default lets frames of 1 MB and more through.'),
        Node(
            package='track_before_detect',
            executable='frame_publisher',
            name='frame_publisher',
            namespace=namespace,
            output='screen',
            additional_env=environment,
            parameters=[
                LaunchConfiguration('publisher_params_file'),
                {
                    'input': ParameterValue(LaunchConfiguration('input'), value_type=str),
                    'scenario': ParameterValue(LaunchConfiguration('scenario'), value_type=str),
                    'loop': ParameterValue(LaunchConfiguration('loop'), value_type=bool),
                    'rate_hz': ParameterValue(LaunchConfiguration('rate_hz'), value_type=float),
                },
            ],
        ),
        Node(
            package='track_before_detect',
            executable='detector',
            name='detector',
            namespace=namespace,
            output='screen',
            additional_env=environment,
            parameters=[LaunchConfiguration('detector_params_file')],
        ),
    ])
