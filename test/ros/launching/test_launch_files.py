"""What launch files start, read by a stand-in for launch, which comes with no wheel.

Where launch is installed, its own classes have to take the same files.
"""

import importlib.util
import json
import os
from pathlib import Path
import re
import sys
from types import ModuleType

import pytest
import yaml

pytest.importorskip('rclpy')

from track_before_detect.ros import detector_node, frame_publisher_node  # noqa: E402
from track_before_detect.ros.recorder import recorder_node  # noqa: E402
from track_before_detect.ros.stitching import stitcher_node  # noqa: E402

ROOT = Path(__file__).parents[3]
FILES = sorted(path.name.removesuffix('.launch.py') for path in ROOT.glob('launch/*.launch.py'))
NODES = {'detector': detector_node, 'frame_publisher': frame_publisher_node,
         'recorder': recorder_node, 'stitcher': stitcher_node}
# Arguments without a default.
NEEDED = {'replay': {'input': 'a.npz'},
          'sensors': {'params_file': str(ROOT / 'config' / 'detector.param.yaml')}}
REAL = importlib.util.find_spec('launch_ros') is not None


def description(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / 'launch' / f'{name}.launch.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


def resolved(item, context):
    """Return the text of a substitution, of a list of them, or of what is text already."""
    if callable(item):
        return item(context)
    return ''.join(resolved(part, context) for part in item) if isinstance(item, list) else item


def declared(name, default_value=None, description=''):
    assert description.endswith('.')

    def run(context, nodes):
        if name not in context:
            assert default_value is not None, f'{name} is not given'
            context[name] = resolved(default_value, context)
    return run


def file_included(source, launch_arguments=(), condition=None):
    def run(context, nodes):
        if condition is None or condition(context):
            context.update({name: resolved(value, context) for name, value in launch_arguments})
            name = Path(resolved(source, context)).name.removesuffix('.launch.py')
            started(name, context, nodes)
    return run


def node_started(parameters=(), remappings=(), arguments=(), additional_env=None, **settings):
    def run(context, nodes):
        file, values = (*parameters, None, {})[:2]
        nodes.append({
            **{name: resolved(value, context) for name, value in settings.items()},
            'file': file and resolved(file, context),
            'parameters': {name: value(context) for name, value in values.items()},
            'remappings': {a: resolved(b, context) for a, b in remappings},
            'arguments': [resolved(part, context) for part in arguments],
            'environment': {name: resolved(value, context)
                            for name, value in (additional_env or {}).items()}})
    return run


def parameter_value(item, value_type):
    convert = {'true': True, 'false': False}.__getitem__ if value_type is bool else value_type
    return lambda context: convert(resolved(item, context))


STAND_IN = {
    'launch': {'LaunchDescription': lambda entities: entities},
    'launch.actions': {'DeclareLaunchArgument': declared,
                       'IncludeLaunchDescription': file_included},
    'launch.conditions': {
        'IfCondition': lambda item: lambda context: resolved(item, context) == 'true'},
    'launch.launch_description_sources': {'PythonLaunchDescriptionSource': lambda path: path},
    'launch.substitutions': {
        'LaunchConfiguration': lambda name: lambda context: context[name],
        'EnvironmentVariable': lambda name, default_value: lambda context: os.environ.get(
            name, resolved(default_value, context)),
        'NotEqualsSubstitution': lambda a, b: lambda context: str(
            resolved(a, context) != resolved(b, context)).lower(),
        'PathJoinSubstitution': lambda parts: lambda context: '/'.join(
            resolved(part, context) for part in parts)},
    'launch_ros': {},
    'launch_ros.actions': {'Node': node_started},
    'launch_ros.parameter_descriptions': {'ParameterValue': parameter_value},
    'launch_ros.substitutions': {'FindPackageShare': lambda _: lambda context: str(ROOT)},
}


def started(name, context, nodes):
    for entity in description(name):
        entity(context, nodes)
    return nodes


@pytest.fixture
def nodes_of(monkeypatch):
    """Return the function that gives the nodes which a file starts, with arguments."""
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
    monkeypatch.delitem(
        sys.modules, 'track_before_detect.ros.executables.launching', raising=False)
    for name, contents in STAND_IN.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)

    def launch(name, **arguments):
        return started(name, dict(arguments), [])

    yield launch
    sys.modules.pop('track_before_detect.ros.executables.launching', None)


@pytest.fixture
def launched(nodes_of):
    """Return the function that gives the nodes which a file starts by their names."""
    return lambda name, **arguments: {
        node['name']: node for node in nodes_of(name, **arguments)}


@pytest.mark.parametrize(('name', 'nodes'), [
    ('demo', {'frame_publisher', 'detector'}), ('detector', {'detector'}),
    ('frame_publisher', {'frame_publisher'}), ('recorder', {'recorder'}),
    ('replay', {'frame_publisher', 'detector'}), ('sensors', {'detector'}),
    ('stitcher', {'stitcher'}), ('view', {'rviz2'})])
def test_a_file_starts_its_nodes_with_parameters_that_exist(launched, name, nodes):
    found = launched(name, **NEEDED.get(name, {}))
    assert found.keys() == nodes
    for executable, node in found.items():
        if executable == 'rviz2':
            continue
        assert node['package'] == 'track_before_detect'
        assert node['executable'] == executable
        assert Path(node['file']) == ROOT / 'config' / f'{executable}.param.yaml'
        # Every node gets large frames through the middleware.
        assert node['environment'].keys() == {
            'FASTRTPS_DEFAULT_PROFILES_FILE', 'MALLOC_MMAP_THRESHOLD_', 'MALLOC_TRIM_THRESHOLD_'}
        assert Path(node['environment']['FASTRTPS_DEFAULT_PROFILES_FILE']).is_file()
        defaults = {parameter.name: parameter.default
                    for parameter in NODES[executable].PARAMETERS} | {'use_sim_time': False}
        assert node['parameters'].keys() <= defaults.keys()
        if name == executable:
            assert node['parameters'] == {key: defaults[key] for key in node['parameters']}


def test_their_page_names_every_file_and_its_arguments(launched):
    page = (ROOT / 'docs/nodes/launch.md').read_text(encoding='utf-8')
    rows = dict(re.findall(r'^\| `(\w+)\.launch\.py` \|.*?\| ([^|]*) \|$', page, re.MULTILINE))
    assert sorted(rows) == FILES
    for name, words in rows.items():
        context = dict(NEEDED.get(name, {}))
        started(name, context, [])
        said = set(re.findall('`(.*?)`', words))
        # Arguments of included files are not named again.
        assert said <= context.keys()
        assert said == context.keys() or words.endswith('those of the files it includes')


def test_the_demo_loops_and_hands_on_what_the_command_line_says(launched):
    assert launched('demo')['frame_publisher']['parameters']['loop'] is True
    found = launched('demo', loop='false', rate_hz='5.0', namespace='left', rviz='true',
                     detector_params_file='mine.yaml', image='/camera')
    assert found['frame_publisher']['parameters']['loop'] is False
    assert found['frame_publisher']['parameters']['rate_hz'] == 5.0
    assert found['detector']['file'] == 'mine.yaml'
    assert found['detector']['remappings']['image'] == '/camera'
    assert {node['namespace'] for node in found.values()} == {'left'}
    assert found['rviz2']['remappings']['/overlay'] == 'overlay'


def test_a_replay_keeps_stamps_has_its_clock_followed_and_is_recorded_when_asked_for(launched):
    found = launched('replay', input='flight.mp4', record='flight.mcap')
    publisher = found['frame_publisher']['parameters']
    assert publisher['input'] == 'flight.mp4'
    assert (publisher['original_stamps'], publisher['loop']) == (True, False)
    assert publisher['clock_hz'] == 100.0
    assert found['detector']['parameters']['use_sim_time'] is True
    assert found['recorder']['parameters'] == {'output': 'flight.mcap'}
    with pytest.raises(AssertionError, match='input is not given'):
        launched('replay')


def test_regions_are_searched_side_by_side_and_merged(nodes_of):
    nodes = nodes_of('regions', image='/camera/image_raw')
    named = {f'{node["namespace"]}/{node["name"]}'.lstrip('/'): node for node in nodes}
    assert named.keys() == {'left/detector', 'right/detector', 'stitcher'}
    file = ROOT / 'config' / 'regions.yaml'
    assert {Path(node['file']) for node in nodes} == {file}
    told = {name.strip('/'): section['ros__parameters']
            for name, section in yaml.safe_load(file.read_text(encoding='utf-8')).items()}
    # Both hear the same frames, and what one of them lacks the other sees.
    for name in ('left/detector', 'right/detector'):
        assert named[name]['remappings']['image'] == '/camera/image_raw'
        known = {parameter.name for parameter in detector_node.PARAMETERS}
        assert (told[name] | told['**/detector']).keys() <= known
    (left, _, width, _), (right, *_) = (
        told[name]['region'] for name in ('left/detector', 'right/detector'))
    assert left < right < left + width
    assert told['stitcher'] == {'inputs': ['left', 'right']}


@pytest.mark.skipif(not REAL, reason='launch is not installed')
def test_launch_itself_takes_the_files():
    for name in FILES:
        assert description(name).entities


@pytest.fixture(scope='module')
def topics():
    """Return the topics that the pages of the nodes, or the recorder, name."""
    pages = [page.read_text(encoding='utf-8') for page in (ROOT / 'docs/nodes').glob('*.md')]
    rows = [row for page in pages for row in re.findall(r'^\| (`[^|]*) \| `', page, re.MULTILINE)]
    named = [name for row in rows for name in re.findall('`([^`]+)`', row)]
    return {f'/{name.lstrip("/")}' for name in [*named, *recorder_node.TOPICS]}


def test_rviz_shows_topics_of_the_nodes_that_the_namespace_moves(launched, topics):
    view = yaml.safe_load((ROOT / 'views/trajectories.rviz').read_text(encoding='utf-8'))
    displays = view['Visualization Manager']['Displays']
    shown = {display['Topic']['Value'] for display in displays}
    assert shown <= topics
    assert launched('view')['rviz2']['remappings'] == {topic: topic[1:] for topic in shown}
    assert Path(launched('view')['rviz2']['arguments'][1]) == ROOT / 'views/trajectories.rviz'


def test_foxglove_lays_out_the_panels_it_configures_with_topics_of_the_nodes(topics):
    layout = json.loads((ROOT / 'views/trajectories.foxglove.json').read_text(encoding='utf-8'))

    def panels(part):
        return {part} if isinstance(part, str) else panels(part['first']) | panels(part['second'])

    assert panels(layout['layout']) == layout['configById'].keys()
    assert set(re.findall(r'"(/[^"]+)"', json.dumps(layout['configById']))) <= topics
