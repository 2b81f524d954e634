"""The page of a node says what its code does."""

from pathlib import Path
import re

import pytest

pytest.importorskip('rclpy')

import rclpy  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from track_before_detect.ros import frame_publisher_node  # noqa: E402
from track_before_detect.ros.detector_node import DetectorNode, PARAMETERS  # noqa: E402

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


def test_it_names_the_topics_and_services_of_the_node_with_their_types(ros_domain, page):
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    node = DetectorNode('page', context=context, parameter_overrides=[
        Parameter('autostart', value=False)])
    try:
        assert node.trigger_configure() == node.trigger_activate()
        name, namespace = node.get_name(), node.get_namespace()
        topics = [*node.get_publisher_names_and_types_by_node(name, namespace),
                  *node.get_subscriber_names_and_types_by_node(name, namespace)]
        own = {topic: types[0] for topic, types in topics
               if not topic.endswith(('/rosout', '/parameter_events', '/transition_event'))}
        services = {service: types[0] for service, types in
                    node.get_service_names_and_types_by_node(name, namespace)}
    finally:
        node.destroy_node()
        context.try_shutdown()
    said = {name.lstrip('/'): kind for name, kind in rows(page).items()}
    assert {name.lstrip('/'): kind for name, kind in own.items()} == {
        name: kind for name, kind in said.items() if not name.startswith('~')}
    for name, kind in said.items():
        if name.startswith('~'):
            assert services[name.replace('~', '/page')] == kind


def test_it_names_the_parameters_of_the_node_alone_and_those_that_are_live(page):
    text = page[page.index('## Parameters'):page.index('## Failure')]
    live, at_start = re.search(
        r'those of the node: (.*?) \(live\), (.*?) \(read at', text, re.DOTALL).groups()
    own = {parameter.name: parameter.live for parameter in PARAMETERS if not parameter.is_option}
    assert set(re.findall('`(.*?)`', live)) == {name for name, is_live in own.items() if is_live}
    assert set(re.findall('`(.*?)`', at_start)) == {
        name for name, is_live in own.items() if not is_live}


@pytest.mark.parametrize('message', ['image', 'frame'])
def test_that_of_the_publisher_names_its_topics_and_parameters(ros_domain, message):
    page = (PAGES / 'frame_publisher.md').read_text(encoding='utf-8')
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    node = frame_publisher_node.FramePublisherNode(context=context, parameter_overrides=[
        Parameter('message', value=message)])
    try:
        topics = {topic.lstrip('/'): types[0] for topic, types in
                  node.get_publisher_names_and_types_by_node('frame_publisher', '/')
                  if not topic.endswith(('/rosout', '/parameter_events'))}
    finally:
        node.destroy_node()
        context.try_shutdown()
    said = rows(page)
    del said[{'image': 'frame', 'frame': 'image'}[message]]
    assert topics == said
    text = page[page.index('at the start:'):page.index('## Failure')]
    assert re.findall('`(.*?)`', text) == [
        parameter.name for parameter in frame_publisher_node.PARAMETERS]
