"""Start the detector."""

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
    """Return the detector with its parameters and the remapping of its inputs."""
    config = [FindPackageShare('track_before_detect'), 'config']
    # Received frames are large blocks, which the allocator shall keep.
    environment = {
        'FASTRTPS_DEFAULT_PROFILES_FILE': LaunchConfiguration('fastdds_profile'),
        'MALLOC_MMAP_THRESHOLD_': '1073741824',
        'MALLOC_TRIM_THRESHOLD_': '1073741824',
    }
    return LaunchDescription([
        DeclareLaunchArgument(
            'params_file',
            default_value=PathJoinSubstitution([*config, 'detector.param.yaml']),
            description='Parameters of the detector.'),
        DeclareLaunchArgument(
            'image', default_value='image',
            description='Topic of the images (sensor_msgs/Image).'),
        DeclareLaunchArgument(
            'frame', default_value='frame',
            description='Topic of plain frames (std_msgs/Float32MultiArray).'),
        DeclareLaunchArgument(
            'namespace', default_value='', description='Namespace of the node and its topics.'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false',
            description='Whether to follow /clock, as for a bag played with --clock.'),
        DeclareLaunchArgument(
            'autostart', default_value='true',
            description='Whether the node configures and activates itself.'),
        DeclareLaunchArgument(
            'fastdds_profile', default_value=EnvironmentVariable(
                'FASTRTPS_DEFAULT_PROFILES_FILE', default_value=PathJoinSubstitution(
                    [*config, 'fastdds_profile.xml'])),
            description='Profile of Fast DDS; the default lets frames of 1 MB and more through.'),
        Node(
            package='track_before_detect',
            executable='detector',
            name='detector',
            namespace=LaunchConfiguration('namespace'),
            output='screen',
            additional_env=environment,
            parameters=[
                LaunchConfiguration('params_file'),
                {name: ParameterValue(LaunchConfiguration(name), value_type=bool)
                 for name in ('use_sim_time', 'autostart')},
            ],
            remappings=[
                ('image', LaunchConfiguration('image')),
                ('frame', LaunchConfiguration('frame')),
            ],
        ),
    ])
