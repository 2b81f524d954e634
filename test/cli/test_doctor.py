"""``tbd doctor``: what it says, and what it calls broken."""

import importlib.util
import json
import os
import platform
import subprocess
import sys

import numba
import numpy as np
import pytest

from track_before_detect import __version__
from track_before_detect.cli import main

WITHOUT_ROS = """
import os, sys, importlib.util
os.cpu_count = lambda cores={cores} or os.cpu_count(): cores
for name in {blocked}:
    sys.modules[name] = None
find_spec = importlib.util.find_spec
importlib.util.find_spec = lambda name: None if name == 'rclpy' else find_spec(name)
from track_before_detect.cli import main
sys.exit(main(['doctor', *sys.argv[1:]]))
"""


def doctor(*arguments, blocked=(), cores=None, **environment):
    """Return the exit code and what is printed where there is no ROS, on so many cores."""
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS.format(blocked=blocked, cores=cores), *arguments],
        capture_output=True, text=True, env={**os.environ, **environment}, timeout=120)
    return done.returncode, done.stdout


def test_versions_cores_caches_and_extras_are_told(tmp_path):
    code, printed = doctor('--json', XDG_CACHE_HOME=str(tmp_path), ROS_DOMAIN_ID='7',
                           A_SECRET='hidden')
    report = json.loads(printed)
    assert code == 0 and report['broken'] == []
    package = report['package']
    assert (package['track_before_detect'], package['python'], package['numpy'],
            package['numba']) == (__version__, platform.python_version(), np.__version__,
                                  numba.__version__)
    assert report['machine']['cores that may be used'] <= report['machine']['cores']
    assert report['machine']['free memory [GB]'] < report['machine']['memory [GB]']
    assert report['caches']['loops'].startswith(str(tmp_path))
    assert report['caches']['loops can be written'] is True
    assert report['extras']['test']['pytest'] == pytest.__version__
    assert report['ROS']['found'] == 'none'
    assert report['environment']['ROS_DOMAIN_ID'] == '7' and 'hidden' not in printed


def test_the_text_says_the_same_and_ends_with_the_verdict():
    code, printed = doctor(cores=1)
    assert code == 0
    assert '  cores: 1\n' in printed and '  loops can be written: yes\n' in printed
    assert f'  track_before_detect: {__version__}\n' in printed
    assert printed.splitlines()[-1] == 'nothing that is needed is broken'


def test_what_is_needed_and_cannot_be_imported_is_broken():
    code, printed = doctor('--json', blocked=('scipy',))
    assert code == 1
    assert any(sentence.startswith('scipy cannot be imported')
               for sentence in json.loads(printed)['broken'])


def test_a_middleware_that_does_not_answer_is_broken(tmp_path, monkeypatch, capsys):
    (tmp_path / 'rclpy.py').touch()
    monkeypatch.syspath_prepend(tmp_path)

    run = subprocess.run

    def asked(*command, **how):
        if 'import rclpy' not in str(command):
            return run(*command, **how)
        raise subprocess.TimeoutExpired(command, how['timeout'])

    monkeypatch.setattr(subprocess, 'run', asked)
    assert main(['doctor', '--json']) == 1
    report = json.loads(capsys.readouterr().out)
    [sentence] = [said for said in report['broken'] if 'rclpy' in said]
    assert sentence.endswith('its middleware did not answer within 30 s')
    assert report['ROS']['middleware'] is None


def test_the_ros_that_is_there_names_its_middleware(capsys):
    if importlib.util.find_spec('rclpy') is None:
        pytest.skip('there is no ROS')
    assert main(['doctor', '--json']) == 0
    ros = json.loads(capsys.readouterr().out)['ROS']
    assert ros['found'] in ('sourced', 'wheels')
    assert ros['middleware'].startswith('rmw_')
    assert ros['messages']['sensor_msgs'] == 'there'
