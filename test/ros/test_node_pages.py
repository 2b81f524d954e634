"""The page of a node says what its code does."""

from pathlib import Path
import re

import pytest

pytest.importorskip('rclpy')

import rclpy  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from track_before_detect.ros import frame_publisher_node  # noqa: E402
from track_before_detect.ros.detector_node import DetectorNode, PARAMETERS  # noqa: E402
from track_before_detect.ros.intake.sensor_inputs import OF_SENSOR  # noqa: E402
from track_before_detect.ros.recorder import recorder_node  # noqa: E402
from track_before_detect.ros.stitching import stitcher_node  # noqa: E402

PAGES = Path(__file__).parents[2] / 'docs' / 'nodes'


@pytest.fixture(scope='module')
def page():
    return (PAGES / 'detector.md').read_text(encoding='utf-8')


def rows(page):
    """Return the interfaces of the page: (name, type), without what stands behind the name."""
    found = []
    for name, types in re.findall(r'^\| (`[^|]*) \| (`[^|]*) \|', page, re.MULTILINE):
        found += zip(re.findall('`([^`]+)`', name), re.findall('`([^`]+)`', types))
    return dict(found)


def interfaces(node, kinds):
    """Return the types of the topics and of the node's own services, named as in the page.

    The node has a name that no process has had: one that was killed is still known for a while.
    """
    name, namespace = node.get_name(), node.get_namespace()
    topics = [pair for kind in kinds for pair in
              getattr(node, f'get_{kind}_names_and_types_by_node')(name, namespace)]
    found = {topic.lstrip('/'): types[0] for topic, types in topics if not topic.endswith(
        ('/rosout', '/parameter_events', '/transition_event'))}
    services = node.get_service_names_and_types_by_node(name, namespace)
    return found, {service.replace(f'/{name}/', '~/'): types[0] for service, types in services}


def said_and_live(page, pattern):
    """Return the names of parameters that the page calls live, and of the others."""
    text = page[page.index('## Parameters'):page.index('## Failure')]
    return [re.findall('`(.*?)`', part) for part in
            re.search(pattern, text, re.DOTALL).groups()]


def test_it_names_the_topics_and_services_of_the_node_with_their_types(ros_domain, page):
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    node = DetectorNode('page', context=context, parameter_overrides=[
        Parameter('autostart', value=False)])
    try:
        assert node.trigger_configure() == node.trigger_activate()
        topics, services = interfaces(node, ('publisher', 'subscriber'))
    finally:
        node.destroy_node()
        context.try_shutdown()
    said = {name.lstrip('/'): kind for name, kind in rows(page).items()}
    assert topics == {name: kind for name, kind in said.items() if not name.startswith('~')}
    for name, kind in said.items():
        if name.startswith('~'):
            assert services[name] == kind


def test_it_names_the_parameters_of_the_node_alone_and_those_that_are_live(page):
    live, at_start = said_and_live(page, r'those of the node: (.*?) \(live\), (.*?) \(read at')
    own = {parameter.name: parameter.live for parameter in PARAMETERS if not parameter.is_option}
    assert set(live) == {name for name, is_live in own.items() if is_live}
    assert set(at_start) == {name for name, is_live in own.items() if not is_live}


def test_it_names_the_parameters_of_each_of_several_sensors(page):
    table = page[page.index('| of each sensor'):page.index('-p sensors:=')]
    names = [name for first in re.findall(r'^\| (`.*?) \|', table, re.MULTILINE)
             for name in re.findall('`(.*?)`', first)]
    assert names == [parameter.name for parameter in OF_SENSOR]


@pytest.mark.parametrize('message', ['image', 'frame'])
def test_that_of_the_publisher_names_its_topics_services_and_parameters(ros_domain, message):
    page = (PAGES / 'frame_publisher.md').read_text(encoding='utf-8')
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    node = frame_publisher_node.FramePublisherNode(
        'page_player', context=context, parameter_overrides=[
            Parameter('message', value=message), Parameter('clock_hz', value=1.0)])
    try:
        topics, services = interfaces(node, ('publisher',))
    finally:
        node.destroy_node()
        context.try_shutdown()
    said = {name.lstrip('/'): kind for name, kind in rows(page).items()}
    del said[{'image': 'frame', 'frame': 'image'}[message]]
    own = {name: kind for name, kind in services.items() if kind.startswith('std_srvs')}
    assert {**topics, **own} == said
    live, at_start = said_and_live(page, r'\(live\): (.*?)\. .*at the start: (.*)')
    parameters = frame_publisher_node.PARAMETERS
    assert live == [parameter.name for parameter in parameters if parameter.live]
    assert at_start == [parameter.name for parameter in parameters if not parameter.live]


def test_that_of_the_recorder_names_its_topics_and_parameters(ros_domain, tmp_path):
    pytest.importorskip('mcap')
    page = (PAGES / 'recorder.md').read_text(encoding='utf-8')
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    node = recorder_node.RecorderNode('page_recorder', context=context, parameter_overrides=[
        Parameter('output', value=str(tmp_path / 'page.mcap'))])
    try:
        topics, _ = interfaces(node, ('publisher', 'subscriber'))
    finally:
        node.destroy_node()
        context.try_shutdown()
    assert topics == {name.lstrip('/'): kind for name, kind in rows(page).items()}
    assert set(re.findall('`(.*?)`', re.search(r'unless told: (.*?)\.\n', page, re.DOTALL)[1])) \
        == set(recorder_node.TOPICS)
    text = page[page.index('## Parameters'):page.index('## Failure')]
    assert re.findall('`(.*?)`', text) == [
        parameter.name for parameter in recorder_node.PARAMETERS]


def test_that_of_the_stitcher_names_its_topics_and_parameters(ros_domain):
    page = (PAGES / 'stitcher.md').read_text(encoding='utf-8')
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    node = stitcher_node.StitcherNode('page_stitcher', context=context, parameter_overrides=[
        Parameter('inputs', value=['one', 'two'])])
    try:
        topics, _ = interfaces(node, ('publisher', 'subscriber'))
    finally:
        node.destroy_node()
        context.try_shutdown()
    said = {name.lstrip('/'): kind for name, kind in rows(page).items()}
    of_input = said.pop('NAME/trajectories/points')
    assert topics == {**said, **{f'{name}/trajectories/points': of_input
                                 for name in ('one', 'two')}}
    text = page[page.index('## Parameters'):page.index('## Failure')]
    assert re.findall('`(.*?)`', text) == [
        parameter.name for parameter in stitcher_node.PARAMETERS]
