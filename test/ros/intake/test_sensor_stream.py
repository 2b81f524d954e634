"""Frames of several sensors go on in the order of their stamps, and wait only so long."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from track_before_detect.errors import DataError, ParameterError  # noqa: E402
from track_before_detect.ros.frame_queue import StreamFrame  # noqa: E402
from track_before_detect.ros.intake.sensor_inputs import (  # noqa: E402
    parameters_of,
    sensor_inputs,
)
from track_before_detect.ros.intake.sensor_stream import SensorStream  # noqa: E402

SHAPES = [(2, 3), (4, 2)]


@pytest.fixture
def stream():
    return SensorStream(['left', 'right'], SHAPES, wait_s=0.5)


def frame(sensor, stamp_s, arrival_s, shape=None):
    return StreamFrame(np.ones(shape or SHAPES[sensor]), stamp_s, None, arrival_s, 0, sensor)


def gone_on(frames):
    return [(one.sensor, one.stamp_s) for one in frames]


def test_they_are_put_in_order_padded_and_numbered(stream):
    passed = []
    for sensor, stamp in [(0, 0.0), (0, 1.0), (1, 0.5), (1, 1.0), (1, 1.5), (0, 2.0)]:
        passed += stream.add(frame(sensor, stamp, arrival_s=10.0))
    # Those of 1.5 and 2.0 s wait: an earlier one could still come.
    assert gone_on(passed) == [(0, 0.0), (1, 0.5), (0, 1.0), (1, 1.0), (1, 1.5)]
    assert [one.index for one in passed] == [0, 1, 2, 3, 4]
    for one in passed:
        height, width = SHAPES[one.sensor]
        assert one.pixels.shape == (4, 3)
        assert np.isfinite(one.pixels).sum() == height * width == one.pixels[:height, :width].sum()


def test_one_that_stops_is_waited_for_once_and_again_after_it_came_back(stream):
    assert not stream.add(frame(0, 0.0, arrival_s=10.0))
    assert stream.deadline_s == 10.5
    assert not stream.due(10.4)
    assert gone_on(stream.due(10.5)) == [(0, 0.0)]
    assert gone_on(stream.add(frame(0, 1.0, arrival_s=11.0))) == [(0, 1.0)]
    assert not stream.add(frame(1, 1.5, arrival_s=11.5))
    assert gone_on(stream.add(frame(0, 2.0, arrival_s=12.0))) == [(1, 1.5)]
    assert stream.deadline_s == 12.5


def test_the_time_that_counts_is_that_of_arrival_not_that_of_a_busy_search(stream):
    stream.add(frame(0, 0.0, arrival_s=10.0))
    # Both lay in the queue until 20.0.
    assert gone_on(stream.add(frame(1, 0.1, arrival_s=10.2))) == [(0, 0.0)]
    assert gone_on(stream.add(frame(0, 1.0, arrival_s=11.0))) == [(1, 0.1)]


def test_what_is_late_repeats_or_has_another_size_is_refused_in_words(stream):
    stream.add(frame(0, 5.0, arrival_s=10.0))
    assert stream.due(10.5)
    for late in (4.0, 4.5):
        with pytest.raises(DataError, match=r'sensor right: a frame is .* s older than those'):
            stream.add(frame(1, late, arrival_s=10.6))
    with pytest.raises(DataError, match='sensor left: expected a stamp after 5.0'):
        stream.add(frame(0, 5.0, arrival_s=10.7))
    with pytest.raises(DataError, match='sensor left: expected frames of 2 x 3 .* found 4 x 2'):
        stream.add(frame(0, 6.0, arrival_s=10.7, shape=(4, 2)))
    assert [count.late for count in stream.counts] == [0, 2]


def test_a_loop_goes_on_and_so_does_a_sensor_whose_clock_is_behind_after_it(stream):
    for stamp in (100.0, 101.0):
        stream.add(frame(0, stamp, arrival_s=stamp))
        stream.add(frame(1, stamp + 0.5, arrival_s=stamp))
    # What still waited goes on before the frames of the next round.
    assert gone_on(stream.add(frame(0, 0.0, arrival_s=102.0))) == [(1, 101.5)]
    # A frame of the round before, and then nothing more of this sensor.
    stream.add(frame(1, 102.5, arrival_s=102.1))
    assert (1, 102.5) in gone_on(stream.due(103.0))
    with pytest.raises(DataError, match='older than'):
        stream.add(frame(0, 1.0, arrival_s=103.1))
    stream.add(frame(0, 3.0, arrival_s=105.0))
    assert gone_on(stream.due(106.0)) == [(0, 3.0)]


def test_silence_is_known_by_the_interval_of_each(stream):
    assert stream.counts[0].silent_s(0.0) == np.inf
    left, right = stream.counts
    for arrival in (10.0, 20.0):
        left.arrive(arrival)
        right.arrive(20.0 + 0.01 * arrival)
    assert left.silent_s(69.0) == 0.0 and left.silent_s(71.0) == pytest.approx(51.0)
    assert right.silent_s(22.0) == 0.0 and right.silent_s(23.0) == pytest.approx(2.8)


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'height': 0}, 'sensors.left.height and width must be told, got 0 and 3'),
    ({'map': [1.0, 0.0]}, 'sensors.left.map must be 6 numbers or none, got 2'),
    ({'mask': 'none.npy'}, 'sensors.left.mask'),
])
def test_what_is_told_of_a_sensor_is_checked(changes, sentence):
    values = {one.name: one.default for one in parameters_of(['left'])}
    values |= {'sensors.left.height': 2, 'sensors.left.width': 3, 'sensors': ['left']}
    [plain] = sensor_inputs(values)
    assert (plain.topic, plain.shape, plain.view.affine) == ('left/image', (2, 3), None)
    values |= {f'sensors.left.{name}': value for name, value in changes.items()}
    with pytest.raises(ParameterError, match=sentence):
        sensor_inputs(values)


@pytest.mark.parametrize('names', [['a', 'a'], ['a b'], ['']])
def test_names_can_be_those_of_topics(names):
    with pytest.raises(ParameterError, match='sensors must be names'):
        parameters_of(names)
