"""What waits for the search thread comes in order, and the oldest make room."""

import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.ros.frame_queue import FrameQueue, StreamSettings

PIXELS = np.zeros((2, 3))
CHANGES = (DetectorOptions(), StreamSettings(4, 4, None, 100, None))


def test_the_oldest_frames_are_dropped_and_counted():
    queue = FrameQueue(3)
    assert [queue.put(PIXELS, float(k), k) for k in range(5)] == [0, 0, 0, 1, 1]
    assert [queue.take(0).frame.tag for _ in range(3)] == [2, 3, 4]
    assert (queue.counters.received, queue.counters.dropped, len(queue)) == (5, 2, 0)


def test_changes_overtake_frames_and_a_flush_comes_after_them():
    queue = FrameQueue(3)
    queue.flush()
    queue.put(PIXELS, 0.0, 'header')
    queue.configure(*CHANGES)
    assert queue.take(0).changes == CHANGES
    assert queue.take(0).frame.tag == 'header'
    assert queue.take(0).flush
    nothing = queue.take(0)
    assert nothing.changes is None and nothing.frame is None and not nothing.flush


@pytest.mark.parametrize('waiting', [0, 2])
def test_a_closed_queue_has_no_more_work(waiting):
    queue = FrameQueue(3)
    for k in range(waiting):
        queue.put(PIXELS, float(k), k)
    queue.close()
    assert queue.take(None) is None
