"""Definitions made of installed classes, beside those that the reader of bags knows."""

import pytest

pytest.importorskip('rclpy')

from rosbags.typesys import get_types_from_msg, get_typestore, Stores  # noqa: E402

from track_before_detect.ros.recorder.definitions import definition, message_class  # noqa: E402


@pytest.mark.parametrize('name', [
    'diagnostic_msgs/msg/DiagnosticArray', 'lifecycle_msgs/msg/TransitionEvent',
    'nav_msgs/msg/Path', 'rcl_interfaces/msg/ParameterDescriptor', 'sensor_msgs/msg/CameraInfo',
    'sensor_msgs/msg/Image', 'sensor_msgs/msg/PointCloud2', 'shape_msgs/msg/SolidPrimitive',
    'std_msgs/msg/Byte', 'std_msgs/msg/Float32MultiArray',
    'visualization_msgs/msg/MarkerArray'])
def test_a_definition_has_the_fields_of_the_type_and_of_all_that_it_holds(name):
    known = get_typestore(Stores.ROS2_JAZZY).fielddefs
    found = get_types_from_msg(definition(name), name)
    assert name in found
    for kind, (_, fields) in found.items():
        assert fields == known[kind][1]


@pytest.mark.parametrize('name', [
    'none_msgs/msg/Image', 'sensor_msgs/msg/Picture', 'MyImage', 'sensor_msgs/msg/__name__',
    'sensor_msgs/Image', '../msg/Image', ''])
def test_a_type_that_is_not_installed_or_none_is_an_import_error(name):
    with pytest.raises(ImportError):
        message_class(name)
