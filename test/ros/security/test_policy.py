"""The policy allows what the nodes do and no more; the walk-through works where its tools are."""

from importlib.util import find_spec
import os
from pathlib import Path
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import pytest

pytest.importorskip('rclpy')

import rclpy  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from track_before_detect.ros.detector_node import DetectorNode  # noqa: E402
from track_before_detect.ros.frame_publisher_node import FramePublisherNode  # noqa: E402
from track_before_detect.ros.recorder.recorder_node import RecorderNode, TOPICS  # noqa: E402
from track_before_detect.ros.stitching.stitcher_node import StitcherNode  # noqa: E402

ROOT = Path(__file__).parents[3]
POLICY = ROOT / 'config' / 'security_policy.xml'
PAGE = ROOT / 'docs' / 'nodes' / 'security.md'
# Of message packages that need not be installed, or only with some parameter.
SOMETIMES = {
    'detector': {*(f'/trajectories/{name}' for name in ('annotations', 'detections',
                                                        'radar_tracks')),
                 '/clock', '/image/compressed'},
    'frame_publisher': {'/frame'},
    'recorder': {'/clock'},
    'stitcher': {'/clock'},
}


def allowed(name, what):
    """Return the full names of what the policy lets a node do."""
    [profile] = ElementTree.parse(POLICY).iterfind(
        f".//context[@path='/track_before_detect/{name}']/profiles/profile[@node='{name}']")
    return {'/' + element.text.replace('~', name).lstrip('/')
            for group in profile if group.get(what) == 'ALLOW' for element in group}


@pytest.fixture(scope='module')
def doing(ros_domain, tmp_path_factory):
    """Return what each node publishes, subscribes to and serves."""
    pytest.importorskip('mcap')
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    output = str(tmp_path_factory.mktemp('recorder') / 'a.mcap')
    # Named unlike any process: one that was killed is still known for a while.
    nodes = {name: kind(f'allowed_{name}', context=context, parameter_overrides=[
        Parameter(parameter, value=value) for parameter, value in values.items()])
        for name, kind, values in (('detector', DetectorNode, {
                                       'autostart': False, 'publish': 'head',
                                       'camera_info': 'camera_info'}),
                                   ('frame_publisher', FramePublisherNode, {'clock_hz': 1.0}),
                                   ('recorder', RecorderNode, {'output': output}),
                                   ('stitcher', StitcherNode, {'inputs': ['left', 'right']}))}
    detector = nodes['detector']
    assert detector.trigger_configure() == detector.trigger_activate()
    found = {(name, what): {
        topic.replace('/allowed_', '/') for topic, _ in getattr(
            node, f'get_{kind}_names_and_types_by_node')(f'allowed_{name}', '/')}
        for name, node in nodes.items() for what, kind in (
            ('publish', 'publisher'), ('subscribe', 'subscriber'), ('reply', 'service'))}
    # It subscribes to each once somebody publishes it.
    found['recorder', 'subscribe'] |= {f'/{topic.lstrip("/")}' for topic in TOPICS}
    for node in nodes.values():
        node.destroy_node()
    context.try_shutdown()
    return found


@pytest.mark.parametrize('what', ['publish', 'subscribe', 'reply'])
@pytest.mark.parametrize('name', SOMETIMES)
def test_a_node_may_do_what_it_does_and_no_more(doing, name, what):
    own, may = doing[name, what], allowed(name, what)
    assert own <= may
    assert may - own <= SOMETIMES[name]


def test_a_node_without_key_ends_with_a_sentence(launch, monkeypatch, tmp_path):
    (tmp_path / 'enclaves').mkdir()
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', str(tmp_path))
    publisher = launch('frame_publisher')
    assert publisher.wait() == 2
    assert 'Traceback' not in publisher.output
    assert 'frame_publisher: error: the node cannot be created: ' in publisher.output


@pytest.mark.skipif(not (shutil.which('ros2') and find_spec('sros2')),
                    reason='the tools of SROS 2 are not installed')
def test_the_walk_through_of_the_page(launch, monkeypatch, tmp_path):
    commands = re.search(r'ros2 security create_keystore.*?done', PAGE.read_text(), re.DOTALL)[0]
    subprocess.run(['bash', '-euc', commands], cwd=tmp_path, check=True,
                   env={**os.environ, 'policy': str(POLICY)})
    outsider = launch('frame_publisher')
    outsider.wait_for_line('waiting for a subscriber')
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', str(tmp_path / 'keystore'))
    detector = launch('detector', '--enclave', '/track_before_detect/detector', '-p',
                      'threshold:=9.0', '-p', 'preset:=none')
    launch('frame_publisher', '--enclave', '/track_before_detect/frame_publisher')
    detector.wait_for_line('3 trajectories now')
    assert 'frames published' not in outsider.output
