"""Show frames and trajectories in RViz."""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from track_before_detect.ros.executables.launching import argument, installed

# What the configuration names; without the first slash they follow the namespace.
TOPICS = ('/overlay', '/trajectories/markers', '/trajectories/points', '/truth/path')


def generate_launch_description() -> LaunchDescription:
    """Return RViz with the configuration of this package."""
    return LaunchDescription([
        argument('rviz_config', installed('views', 'trajectories.rviz'), 'Configuration of RViz.'),
        argument('frame_id', 'camera', 'Coordinate frame in the headers of the frames.'),
        argument('namespace', '', 'Namespace of the nodes and their topics.'),
        Node(package='rviz2', executable='rviz2', name='rviz2', output='screen',
             namespace=LaunchConfiguration('namespace'),
             arguments=['-d', LaunchConfiguration('rviz_config'),
                        '-f', LaunchConfiguration('frame_id')],
             remappings=[(topic, topic[1:]) for topic in TOPICS]),
    ])
