"""Message packages that wheels do not bring, made from their published fields by ROS's generators.

They are the real ones, filled and checked like those of an installed package. One is compiled too,
to be sent; all would take 20 s.
"""

import importlib
import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig

import numpy as np
import pytest

HEADER, TIME = 'std_msgs/Header header', 'builtin_interfaces/Time timestamp'
TYPE_SUPPORTS = 'rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c'
USED = ('builtin_interfaces', 'geometry_msgs', 'std_msgs', 'unique_identifier_msgs')
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
        'ImageAnnotations': [
            f'foxglove_msgs/{kind}Annotation[] {field}' for kind, field in (
                ('Circle', 'circles'), ('Points', 'points'), ('Text', 'texts'))],
    },
}


def extension_of(module):
    """Return what a generator of ROS's wheels adds to the command ``rosidl``.

    The command itself refuses the wheels, which name each generator twice.
    """
    from rosidl_cli.command.generate.extensions import GenerateCommandExtension
    return next(kind for kind in vars(module).values()
                if isinstance(kind, type) and issubclass(kind, GenerateCommandExtension)
                and kind is not GenerateCommandExtension)


def python_only():
    """Return the generator of the classes, which may be filled and checked but not sent."""
    import rosidl_generator_py.cli
    return [(rosidl_generator_py.cli, {'typesupport_implementations': []})]


def to_be_sent():
    """Return all generators that a message to be sent needs."""
    import rosidl_generator_c.cli
    import rosidl_generator_py.cli
    import rosidl_typesupport_c.cli
    import rosidl_typesupport_fastrtps_c.cli
    import rosidl_typesupport_introspection_c.cli
    return [
        (rosidl_generator_c.cli, {}), (rosidl_typesupport_fastrtps_c.cli, {}),
        (rosidl_typesupport_introspection_c.cli, {}),
        (rosidl_typesupport_c.cli, {'typesupport_implementations': list(TYPE_SUPPORTS)}),
        (rosidl_generator_py.cli, {'typesupport_implementations': ['rosidl_typesupport_c']})]


def generate(package, generators, folder):
    """Write the sources of a package below a folder, as a build of it does."""
    from rosidl_adapter.msg import convert_msg_to_idl
    kinds = PACKAGES[package]
    source, output = folder / 'source' / package, folder / package
    (source / 'msg').mkdir(parents=True)
    (output / 'msg').mkdir(parents=True)
    (output / '__init__.py').touch()
    for name, lines in kinds.items():
        (source / 'msg' / f'{name}.msg').write_text('\n'.join([*lines, '']))
        convert_msg_to_idl(source, package, Path('msg', f'{name}.msg'), output / 'msg')
    files = [f'{output}:msg/{name}.idl' for name in kinds]
    known = [str(Path(sys.prefix, 'share', name)) for name in USED]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('AMENT_PREFIX_PATH', sys.prefix, prepend=os.pathsep)
        for module, options in generators:
            extension_of(module)('', **options).generate(package, files, known, output)


def build(package, folder):
    """Compile a generated package."""
    prefix, output = Path(sys.prefix), folder / package
    include = [*(prefix / 'include').iterdir(), prefix / 'include', folder,
               sysconfig.get_paths()['include'], np.get_include()]
    flags = ['-fPIC', '-w', *(f'-I{path}' for path in include)]
    libraries = [path for name in (*(f'{used}__rosidl_{part}' for used in USED
                                     for part in ('*_c', 'generator_py')), 'rosidl_*_c', 'fastcdr')
                 for path in (prefix / 'lib').glob(f'lib{name}.so*')]
    libraries += [f'-Wl,-rpath,{prefix / "lib"},-rpath,{output}', '-Wl,--no-as-needed']

    def compiled(sources, made):
        subprocess.run(['gcc', *flags, '-shared', *sources, *libraries, '-lstdc++', '-o', made,
                        f'-Wl,-soname,{made.name}'], check=True)
        libraries.append(made)

    # Looked up by these names, and found as the module has loaded them.
    detail = output / 'msg' / 'detail'
    fast, introspection = (output / f'lib{package}__{name}.so' for name in TYPE_SUPPORTS)
    compiled(detail.glob('*__type_support_c.cpp'), fast)
    compiled(detail.glob('*__type_support.c'), introspection)
    rest = {*output.rglob('*.c*')} - {*detail.glob('*__type_support*')}
    suffix = sysconfig.get_config_var('EXT_SUFFIX')
    compiled(rest, output / f'{package}_s__rosidl_typesupport_c{suffix}')


def is_installed(package):
    return importlib.util.find_spec(package) is not None


@pytest.fixture(scope='module')
def messages(tmp_path_factory):
    """Return the modules of the messages by package; their classes check what they are given."""
    pytest.importorskip('rosidl_generator_py')
    folder = tmp_path_factory.mktemp('messages')
    made = [package for package in PACKAGES if not is_installed(package)]
    for package in made:
        generate(package, python_only(), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_PYTHON_CHECK_FIELDS', '1')
        patch.syspath_prepend(folder)
        yield {package: importlib.import_module(f'{package}.msg') for package in PACKAGES}
    forget(made)


@pytest.fixture
def sent_radar_msgs(tmp_path, monkeypatch):
    """Return ``radar_msgs.msg`` that can be sent, also by processes that are started."""
    if not is_installed('radar_msgs'):
        pytest.importorskip('rosidl_generator_py')
        if shutil.which('gcc') is None:
            pytest.skip('messages that are sent need a compiler (gcc)')
        generate('radar_msgs', to_be_sent(), tmp_path)
        build('radar_msgs', tmp_path)
        monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
        monkeypatch.syspath_prepend(tmp_path)
        yield importlib.import_module('radar_msgs.msg')
        forget(['radar_msgs'])
    else:
        yield importlib.import_module('radar_msgs.msg')


def forget(packages):
    """Let packages be not installed again."""
    for name in [name for name in sys.modules if name.partition('.')[0] in packages]:
        del sys.modules[name]
