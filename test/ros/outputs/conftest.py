"""Message packages that wheels do not bring, made from their published fields by ROS's generator.

They check the type of every field that is set. Compiled type support is not made, so they can be
filled but not sent.
"""

import importlib
import json
from pathlib import Path
import sys

import pytest

HEADER, TIME = 'std_msgs/Header header', 'builtin_interfaces/Time timestamp'
# As of vision_msgs 4.1, radar_msgs 0.2 and foxglove_msgs 2.2.
PACKAGES = {
    'vision_msgs': {
        'Point2D': ['float64 x', 'float64 y'],
        'Pose2D': ['vision_msgs/Point2D position', 'float64 theta'],
        'BoundingBox2D': ['vision_msgs/Pose2D center', 'float64 size_x', 'float64 size_y'],
        'ObjectHypothesis': ['string class_id', 'float64 score'],
        'ObjectHypothesisWithPose': ['ObjectHypothesis hypothesis',
                                     'geometry_msgs/PoseWithCovariance pose'],
        'Detection2D': [HEADER, 'ObjectHypothesisWithPose[] results', 'BoundingBox2D bbox',
                        'string id'],
        'Detection2DArray': [HEADER, 'Detection2D[] detections'],
    },
    'radar_msgs': {
        'RadarTrack': [
            'uint16 NO_CLASSIFICATION=0', 'uint16 STATIC=1', 'uint16 DYNAMIC=2',
            'unique_identifier_msgs/UUID uuid', 'geometry_msgs/Point position',
            *[f'geometry_msgs/Vector3 {name}' for name in ('velocity', 'acceleration', 'size')],
            'uint16 classification',
            *[f'float32[6] {name}_covariance'
              for name in ('position', 'velocity', 'acceleration', 'size')]],
        'RadarTracks': [HEADER, 'radar_msgs/RadarTrack[] tracks'],
    },
    'foxglove_msgs': {
        'Point2': ['float64 x', 'float64 y'],
        'Color': ['float64 r', 'float64 g', 'float64 b', 'float64 a'],
        'CircleAnnotation': [
            TIME, 'foxglove_msgs/Point2 position', 'float64 diameter', 'float64 thickness',
            'foxglove_msgs/Color fill_color', 'foxglove_msgs/Color outline_color'],
        'PointsAnnotation': [
            TIME, 'uint8 type', 'foxglove_msgs/Point2[] points',
            'foxglove_msgs/Color outline_color', 'foxglove_msgs/Color[] outline_colors',
            'foxglove_msgs/Color fill_color', 'float64 thickness'],
        'TextAnnotation': [
            TIME, 'foxglove_msgs/Point2 position', 'string text', 'float64 font_size',
            'foxglove_msgs/Color text_color', 'foxglove_msgs/Color background_color'],
        'ImageAnnotations': [f'foxglove_msgs/{kind}Annotation[] {kind.lower()}s'
                             for kind in ('Circle', 'Points')] + [
            'foxglove_msgs/TextAnnotation[] texts'],
    },
}


def generate(package, kinds, folder):
    """Write the Python classes of a package below a folder, as a build of it does."""
    from ament_index_python import get_package_share_directory
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_py import generate_py
    source, output = folder / 'source' / package, folder / package
    (source / 'msg').mkdir(parents=True)
    (output / 'msg').mkdir(parents=True)
    (output / '__init__.py').touch()
    for name, lines in kinds.items():
        (source / 'msg' / f'{name}.msg').write_text('\n'.join([*lines, '']))
        convert_msg_to_idl(source, package, Path('msg', f'{name}.msg'), output / 'msg')
    arguments = folder / f'{package}.json'
    arguments.write_text(json.dumps({
        'package_name': package, 'output_dir': str(output), 'target_dependencies': [],
        'template_dir': f'{get_package_share_directory("rosidl_generator_py")}/resource',
        'idl_tuples': [f'{output}:msg/{name}.idl' for name in kinds],
        'ros_interface_dependencies': []}))
    # None of the type supports, which are C to be compiled.
    generate_py(str(arguments), [])


@pytest.fixture(scope='module')
def messages(tmp_path_factory):
    """Return the modules of the messages by package, those that are installed where they are."""
    pytest.importorskip('rosidl_generator_py')
    folder = tmp_path_factory.mktemp('messages')
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('AMENT_PREFIX_PATH', sys.prefix, prepend=':')
        patch.setenv('ROS_PYTHON_CHECK_FIELDS', '1')
        patch.syspath_prepend(folder)
        made = []
        for package, kinds in PACKAGES.items():
            if importlib.util.find_spec(package) is None:
                generate(package, kinds, folder)
                made.append(package)
        importlib.invalidate_caches()
        yield {package: importlib.import_module(f'{package}.msg') for package in PACKAGES}
        for name in [name for name in sys.modules if name.partition('.')[0] in made]:
            del sys.modules[name]
