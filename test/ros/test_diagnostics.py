"""The level of the diagnostics message and its sentence follow from the state of the search."""

import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402

from track_before_detect.ros.diagnostics import (  # noqa: E402
    diagnostics_message,
    Reception,
    Warnings,
)
from track_before_detect.ros.frame_queue import Counters  # noqa: E402
from track_before_detect.ros.search_results import Status  # noqa: E402


def status_of(status, warnings):
    message = diagnostics_message('ns/detector', Time(sec=5), status, Counters(received=7), 3,
                                  Reception(n_lost=2), warnings)
    assert message.header.stamp == Time(sec=5)
    [found] = message.status
    assert found.name == 'ns/detector'
    values = {value.key: value.value for value in found.values}
    assert (values['frames_received'], values['frames_waiting'], values['messages_lost'],
            values['last_warning']) == ('7', '3', '2', warnings.last)
    return found.level, found.message


@pytest.mark.parametrize(('state', 'warned', 'expected'), [
    ('ready', False, (DiagnosticStatus.OK, 'ready: for 3 x 5 frames')),
    ('ready', True, (DiagnosticStatus.WARN, 'a frame is missing')),
    ('failed', True, (DiagnosticStatus.ERROR, 'failed: for 3 x 5 frames')),
], ids=['well', 'recent warning', 'failed'])
def test_the_worst_of_state_and_warning_is_the_level(state, warned, expected):
    warnings = Warnings([].append)
    if warned:
        warnings.add('frames', 'a frame is missing')
    assert status_of(Status(state, 'for 3 x 5 frames'), warnings) == expected


def test_a_warning_is_logged_once_of_each_kind_and_the_newest_is_kept():
    logged = []
    warnings = Warnings(logged.append)
    for k, kind in enumerate('aaba'):
        warnings.add(kind, f'{kind} {k}')
    assert logged == ['a 0', 'b 2']
    assert warnings.last == 'a 3'
