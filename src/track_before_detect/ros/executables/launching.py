"""What the launch files share: a node of this package with its arguments, and files included."""

from collections.abc import Iterable, Mapping
from typing import Any

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'track_before_detect'
PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def installed(*parts: str) -> PathJoinSubstitution:
    """Return the path of an installed file."""
    return PathJoinSubstitution([FindPackageShare(PACKAGE), *parts])


def argument(name: str, default: Any, description: str) -> DeclareLaunchArgument:
    """Return an argument of the command line."""
    return DeclareLaunchArgument(name, default_value=default, description=description)


def included(name: str, **settings: Any) -> IncludeLaunchDescription:
    """Return another launch file of this package; it finds arguments that are set already."""
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(installed('launch', f'{name}.launch.py')), **settings)


def node(name: str, params_argument: str, parameters: Mapping[str, tuple[str, type, str]],
         topics: Iterable[str] = ()) -> list[Any]:
    """Return a node of this package, behind the arguments that it takes.

    Parameters
    ----------
    name : str
        Of the node and its executable.
    params_argument : str
        Argument that names its file of parameters.
    parameters : mapping from str to (str, type, str)
        Parameters that are arguments too: default, type and description.
    topics : iterable of str
        Topics that arguments of their names remap.
    """
    return [
        *[argument(parameter, default, description)
          for parameter, (default, _, description) in parameters.items()],
        *[argument(topic, topic, f'Topic that is taken for {topic}.') for topic in topics],
        argument(params_argument, installed('config', f'{name}.param.yaml'),
                 f'Parameters of the node {name}; the other arguments win over them.'),
        argument('namespace', '', 'Namespace of the nodes and their topics.'),
        argument('fastdds_profile', EnvironmentVariable(
            PROFILE, default_value=installed('config', 'fastdds_profile.xml')),
            'Profile of Fast DDS; the default lets frames of 1 MB and more through.'),
        Node(
            package=PACKAGE, executable=name, name=name, output='screen',
            namespace=LaunchConfiguration('namespace'),
            # Frames are large blocks, which the allocator shall keep.
            additional_env={PROFILE: LaunchConfiguration('fastdds_profile'),
                            'MALLOC_MMAP_THRESHOLD_': '1073741824',
                            'MALLOC_TRIM_THRESHOLD_': '1073741824'},
            parameters=[LaunchConfiguration(params_argument), {
                parameter: ParameterValue(LaunchConfiguration(parameter), value_type=kind)
                for parameter, (_, kind, _) in parameters.items()}],
            remappings=[(topic, LaunchConfiguration(topic)) for topic in topics]),
    ]
