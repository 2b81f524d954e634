"""Start the detector."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the detector with its parameters and the remapping of its inputs."""
    defaults = PathJoinSubstitution(
        [FindPackageShare('track_before_detect'), 'config', 'detector.param.yaml'])
    return LaunchDescription([
        DeclareLaunchArgument(
            'params_file', default_value=defaults, description='Parameters of the detector.'),
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
        Node(
            package='track_before_detect',
            executable='detector',
            name='detector',
            namespace=LaunchConfiguration('namespace'),
            output='screen',
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
