"""What waits for the search thread comes in order, and the oldest make room."""

import threading

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.ros.frame_queue import FrameQueue, StreamRequest

PIXELS = np.zeros((2, 3))
REQUEST = StreamRequest('none', {'batch_length': 4})


def test_the_oldest_frames_are_dropped_and_counted():
    queue = FrameQueue(3)
    assert [queue.put(PIXELS, float(k), k) for k in range(5)] == [0, 0, 0, 1, 1]
    assert [queue.take(0).frame.tag for _ in range(3)] == [2, 3, 4]
    assert (queue.counters.received, queue.counters.dropped, len(queue)) == (5, 2, 0)


def test_changes_overtake_frames_and_a_flush_comes_after_them():
    queue = FrameQueue(3)
    queue.flush()
    queue.put(PIXELS, 0.0, 'header')
    queue.configure(REQUEST)
    assert queue.take(0).request is REQUEST
    assert queue.take(0).frame.tag == 'header'
    assert queue.take(0).flush
    nothing = queue.take(0)
    assert nothing.request is None and nothing.frame is None and not nothing.flush


@pytest.mark.parametrize('seconds', [1e9, 5e10, 1e300, np.inf])
def test_work_is_waited_for_however_long_that_may_be(seconds):
    queue = FrameQueue(3)
    later = threading.Timer(0.1, queue.put, (PIXELS, 0.0, 'header'))
    later.start()
    assert queue.take(seconds).frame.tag == 'header'


@pytest.mark.parametrize('waiting', [0, 2])
def test_a_closed_queue_has_no_more_work(waiting):
    queue = FrameQueue(3)
    for k in range(waiting):
        queue.put(PIXELS, float(k), k)
    queue.close()
    assert queue.take(None) is None


@pytest.mark.parametrize(('preset', 'told', 'batch_length', 'hop', 'queue_length'), [
    ('none', {}, 20, 10, 40), ('auto', {}, 20, 10, 40), ('none', {'batch_length': 7}, 7, 3, 14),
    ('eoir_static', {}, 16, 8, 32), ('eoir_static', {'hop': 2}, 16, 2, 32),
    ('eoir_static', {'batch_length': 8}, 8, 4, 16), ('eoir_static', {'hop': 18}, 18, 18, 36),
])
def test_what_was_told_of_the_batches_wins_and_the_rest_follows(
        preset, told, batch_length, hop, queue_length):
    request = StreamRequest(preset, told)
    settings = request.settings(request.unseen.options)
    assert (settings.batch_length, settings.hop, settings.queue_length) == (
        batch_length, hop, queue_length)


def test_a_preset_is_chosen_by_frames_where_asked_for_and_what_was_told_stays():
    scene = 1000 + 50 * np.random.default_rng(0).standard_normal((6, 24, 32))
    request = StreamRequest('auto', {'noise': 'robust', 'batch_length': 12})
    assert request.looks and request.unseen.options.background == 'none'
    options, reasons = request.chosen(scene)
    assert options.background != 'none' and reasons
    assert (options.noise, options.batch_length, options.hop) == ('robust', 12, 6)
    assert request.window(None).length == request.window(options).length == 12
    named = StreamRequest('none', {'batch_length': 50})
    assert not named.looks and named.chosen(scene) is named.unseen
    assert (named.window(None).length, named.window(named.unseen.options).length) == (20, 50)


def test_a_hop_beyond_the_batch_is_refused():
    for preset in ('none', 'auto'):
        with pytest.raises(ParameterError, match=r'at most batch_length \(20\), got 30'):
            StreamRequest(preset, {'hop': 30}).window(None)
