"""The package as it is installed: metadata that agree, who imports whom, documents that fit."""

import ast
from collections import Counter
import graphlib
import json
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

import track_before_detect

PACKAGE = 'track_before_detect'
SOURCE = Path(track_before_detect.__file__).parent
ROOT = Path(__file__).parents[1]
MODULES = sorted(SOURCE.rglob('*.py'))

# Rooms of the package to the rooms of the package they may import, beside their own. The file
# names without a suffix are modules; everything else is a folder.
BASICS = {'errors', 'array_option', 'atomic_files', 'capabilities', 'checks', 'types', 'options',
          'geometry', 'parallel', 'timestamps'}
ALLOWED = {
    '__init__': BASICS | {'detection', 'models', 'solvers'},
    'errors': set(),
    'geometry': set(),
    'types': set(),
    'atomic_files': set(),
    'parallel': set(),
    'timestamps': set(),
    'array_option': {'errors', 'recordings'},
    'checks': {'errors'},
    'options': {'errors', 'array_option', 'checks'},
    'capabilities': {'errors', 'options'},
    'kernels': set(),
    'option_models': BASICS | {'models'},
    'models': {'errors', 'geometry', 'kernels'},
    'preprocess': BASICS | {'kernels'},
    'solvers': BASICS | {'kernels', 'models', 'option_models'},
    'tracking': BASICS | {'kernels', 'models', 'option_models', 'preprocess', 'solvers'},
    'recordings': BASICS,
    'results': BASICS | {'option_models', 'recordings'},
    'simulation': BASICS | {'models'},
    'runs': {'errors', 'parallel', 'types'},
    'detection': BASICS | {'preprocess', 'solvers', 'tracking'},
    'evaluation': BASICS | {'__init__', 'kernels', 'models', 'option_models', 'preprocess',
                            'recordings', 'runs', 'simulation', 'solvers', 'tracking'},
    'inspection': BASICS | {'option_models', 'preprocess', 'recordings', 'solvers', 'tracking'},
    'cli': BASICS | {'__init__', 'detection', 'evaluation', 'inspection', 'kernels',
                     'option_models', 'option_tables', 'recordings', 'results', 'runs',
                     'simulation', 'solvers', 'tracking'},
    'option_tables': {'options', 'capabilities'},
    'ros': BASICS | {'__init__', 'cli', 'inspection', 'option_tables', 'recordings', 'simulation',
                     'tracking'},
}
# The same within a room, for its folders and for files that lie beside them. What is not listed
# here, such as the files at the top of the solvers, binds the others together.
TOOLS = {'search', 'refine', 'calibration', 'fit'}
FRAME = {'batch_detector', 'pixel_statistics', 'watch'}
WITHIN = {
    'solvers': {
        'search': {'batch_detector'},
        'refine': set(),
        'fit': {'watch'},
        'calibration': {'path_statistic', 'search'},
        'convex': TOOLS | {'batch_detector', 'path_detector', 'path_statistic', 'watch'},
        'clutter': TOOLS | {'batch_detector', 'path_detector'},
        'given_paths': set(),
        'ring': FRAME | {'calibration'},
        'cancellation': FRAME | {'calibration'},
        'velocity': FRAME | {'calibration'},
    },
    'evaluation': {
        'metrics': set(),
        'engine': {'metrics'},
    },
}
MOST_FILES = 14


def imported_names(path):
    """Return the dotted names a file imports, wherever in the file."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f'{path}: imports are absolute'
            if node.module == PACKAGE:
                yield from (f'{PACKAGE}.{alias.name}' for alias in node.names)
            else:
                yield node.module


def room_of(path):
    return path.relative_to(SOURCE).parts[0].removesuffix('.py')


def module_of(path):
    parts = path.relative_to(SOURCE.parent).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


@pytest.mark.parametrize('path', MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_a_room_imports_only_the_rooms_below_it(path):
    room = room_of(path)
    rooms = {child.name.removesuffix('.py') for child in SOURCE.iterdir()}
    ours = {name.split('.')[1] for name in imported_names(path)
            if name.startswith(f'{PACKAGE}.')}
    # A name that is no file or folder, such as __version__, comes from the package itself.
    ours = {name if name in rooms else '__init__' for name in ours}
    assert ours - {room} <= ALLOWED[room]


@pytest.mark.parametrize(('room', 'folder'), [
    (room, folder) for room, folders in WITHIN.items() for folder in folders])
def test_a_folder_of_a_room_imports_only_the_folders_below_it(room, folder):
    paths = sorted((SOURCE / room / folder).rglob('*.py'))
    assert paths
    prefix = f'{PACKAGE}.{room}.'
    for path in paths:
        ours = {name.removeprefix(prefix).split('.')[0] for name in imported_names(path)
                if name.startswith(prefix)}
        assert ours - {folder} <= WITHIN[room][folder], path


def test_imports_make_no_circle():
    modules = {module_of(path): path for path in MODULES}
    imports = {}
    for module, path in modules.items():
        imports[module] = set()
        for node in ast.parse(path.read_text(encoding='utf-8')).body:
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    full = f'{node.module}.{alias.name}'
                    imports[module].add(full if full in modules else node.module)
        # Importing a module runs the package it is in first, which may not import it in turn.
        imports[module] &= modules.keys() - {PACKAGE}
    graphlib.TopologicalSorter(imports).prepare()


@pytest.mark.parametrize('top', [SOURCE, ROOT / 'test'], ids=['package', 'tests'])
def test_no_folder_holds_more_files_than_can_be_looked_over(top):
    files = Counter(path.parent for path in top.rglob('*.py'))
    assert files
    assert {folder: count for folder, count in files.items() if count > MOST_FILES} == {}


def test_no_solver_asks_for_the_type_of_a_model():
    models = {node.name for path in MODULES if path.relative_to(SOURCE).parts[0] == 'models'
              for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
              if isinstance(node, ast.ClassDef)}
    asked = []
    for path in MODULES:
        if path.relative_to(SOURCE).parts[0] == 'solvers':
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
                if isinstance(node, ast.Call) and ast.unparse(node.func) == 'isinstance':
                    names = {one.id for one in ast.walk(node.args[1]) if isinstance(one, ast.Name)}
                    asked += [(path.name, name) for name in names & models]
    # What a caller hands to ``fit_paths`` is a model, or an array of which one is made.
    assert {path for path, _ in asked} <= {'fit_paths.py'}


@pytest.mark.parametrize('path', MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_only_the_nodes_import_ros(path):
    ros = {name for name in imported_names(path)
           if re.match(r'(rclpy|launch|ament|\w+_(msgs|srvs|interfaces))\b', name)}
    assert not ros or room_of(path) == 'ros'


def test_package_and_command_work_without_ros():
    blocked = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == 'rclpy' or name.partition('.')[0].endswith('_msgs'):
            raise ImportError(f'{name} is blocked')

sys.meta_path.insert(0, Blocker())
import track_before_detect
from track_before_detect.cli import main
sys.exit(main(['simulate', '--list']))
"""
    done = subprocess.run([sys.executable, '-c', blocked], capture_output=True, text=True,
                          cwd=SOURCE.parent, timeout=120)
    assert done.returncode == 0, done.stderr
    assert 'eo_ir_drones' in done.stdout


def test_detectors_load_without_the_slow_parts_of_scipy():
    program = 'import sys, track_before_detect.tracking.pipeline; print(*sys.modules)'
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          cwd=SOURCE.parent, timeout=120, check=True)
    loaded = done.stdout.split()
    assert 'scipy.ndimage' in loaded
    assert not {'scipy.stats', 'scipy.signal'} & set(loaded)


def document(name):
    path = ROOT / name
    if not path.exists():
        pytest.skip('the tests do not run from the source folder')
    return path.read_text(encoding='utf-8')


DOCUMENTS = ('README.md', 'CONTRIBUTING.md', 'docs/architecture.md')


@pytest.mark.parametrize('name', DOCUMENTS)
def test_every_file_that_a_document_links_to_exists(name):
    links = re.findall(r'\]\(([^)#:]+)(?:#[^)]*)?\)', document(name))
    assert links
    folder = (ROOT / name).parent
    assert [link for link in links if not (folder / link).exists()] == []


@pytest.mark.parametrize('name', DOCUMENTS)
def test_every_path_that_a_document_names_exists(name):
    # A file of Python, or a folder: `solvers/greedy.py`, `test/ros/`, `docs/constants/`.
    paths = re.findall(r'`((?:[\w.-]+/)*(?:[\w-]+\.py|[\w-]+/))`', document(name))
    assert paths
    of_the_user = {'output/', 'result/'}
    assert [path for path in paths if path not in of_the_user
            and not (SOURCE / path).exists() and not (ROOT / path).exists()] == []


def test_every_name_of_the_index_is_defined_in_its_file():
    entries = re.findall(r'`([\w/]+\.py)`: ((?:`\w+`(?:, )?)+)', document('docs/architecture.md'))
    assert len(entries) > 40
    missing = []
    for path, names in entries:
        source = SOURCE / path
        text = source.read_text(encoding='utf-8') if source.exists() else ''
        missing += [(path, name) for name in re.findall(r'`(\w+)`', names) if not re.search(
            rf'^ *(class|def) {name}\b|^ *{name}\b.*[:=]', text, re.MULTILINE)]
    assert missing == []


def test_one_detection_is_understood_from_a_few_files():
    order = document('docs/architecture.md').partition('reading order\n')[2].partition('\n## ')[0]
    files = re.findall(r'`([\w/]+\.py)`', order)
    assert 15 <= len(files) <= 25
    assert len(files) == len(set(files))


def manifest():
    path = ROOT / 'package.xml'
    if not path.exists():
        pytest.skip('the tests do not run from the source folder')
    return ElementTree.parse(path).getroot()


@pytest.fixture(scope='module')
def metadata():
    """Return what setup.py declares, as pip and colcon read it."""
    document('setup.py')
    program = """
import json, setuptools
from distutils.core import run_setup

made = run_setup('setup.py', stop_after='init')
print(json.dumps({'version': made.get_version(), 'extras': made.extras_require,
                  'readme': made.get_long_description()[:30]}))
"""
    done = subprocess.run([sys.executable, '-W', 'ignore', '-c', program], capture_output=True,
                          text=True, cwd=ROOT, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_version_has_one_source_which_the_other_files_repeat(metadata):
    version = track_before_detect.__version__
    assert metadata['version'] == version
    assert manifest().findtext('version') == version
    assert re.search('^version: (.+)$', document('CITATION.cff'), re.MULTILINE)[1] == version
    assert version not in document('setup.py') + document('docs/conf.py')


def test_the_extra_all_brings_what_users_may_ask_for_and_no_tools_of_developers(metadata):
    extras = metadata['extras']
    everything = set(extras['all'])
    for name in ('readers', 'video', 'plots', 'cli', 'parallel'):
        assert set(extras[name]) <= everything
    for name in ('test', 'lint', 'docs'):
        assert not set(extras[name]) <= everything


# Keys of rosdep/python.yaml in github.com/ros/rosdistro that resolve on Ubuntu 24.04.
LOOKED_UP = {f'python3-{name}' for name in (
    'hypothesis', 'matplotlib', 'numba', 'numpy', 'pil', 'pytest', 'scipy', 'tqdm', 'yaml')}


def test_every_key_of_the_manifest_is_a_package_of_ros_that_is_imported_or_was_looked_up():
    keys = {element.text for element in manifest().iter() if element.tag.endswith('depend')}
    imported = {name.partition('.')[0] for folder in (SOURCE / 'ros', ROOT / 'launch')
                for path in folder.rglob('*.py') for name in imported_names(path)}
    assert keys - imported == LOOKED_UP


def test_manifest_makes_an_ament_python_package():
    root = manifest()
    assert root.get('format') == '3'
    assert root.findtext('name') == PACKAGE
    assert root.findtext('export/build_type') == 'ament_python'
    assert (ROOT / root.find('license').get('file')).is_file()
    # colcon takes a package whose maintainer has no valid address for one without ROS.
    address = root.find('maintainer').get('email')
    assert re.fullmatch(r'[-\w.%+]+@[-\w%+]+(\.[-\w%+]+)*\.[a-zA-Z]{2,}', address)


def test_manifest_names_every_ros_package_that_is_imported():
    depends = {element.text for element in manifest().iter('exec_depend')}
    imported = {name.partition('.')[0] for path in (SOURCE / 'ros').rglob('*.py')
                for name in imported_names(path)}
    imported |= {name.partition('.')[0] for path in (ROOT / 'launch').glob('*.py')
                 for name in imported_names(path)}
    of_ros = {name for name in imported
              if re.fullmatch(r'rclpy|launch(_\w+)?|\w+_(msgs|srvs|interfaces|python)', name)}
    assert of_ros
    assert of_ros <= depends


def test_setup_script_knows_every_command_of_its_help():
    script = ROOT / 'ros2_ws_setup.sh'
    if not script.exists():
        pytest.skip('the tests do not run from the source folder')
    text = subprocess.run(['bash', str(script), '--help'], capture_output=True, text=True,
                          check=True, timeout=30).stdout
    for command in ('setup', 'demo', 'test', 'build', 'docs'):
        assert re.search(rf'^  {command}\b', text, re.MULTILINE)
    refused = subprocess.run(['bash', str(script), 'nonsense'], capture_output=True, text=True,
                             timeout=30)
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
