"""The search thread with a pipeline of the test's own; nothing is sent."""

import time

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.ros.frame_queue import StreamSettings
from track_before_detect.ros.worker import StreamWorker
from track_before_detect.types import DetectionResult

TIMEOUT_S = 60.0
SETTINGS = StreamSettings(batch_length=4, hop=4, max_gap_s=None, queue_length=100,
                                 flush_after_s=None)


class Pipeline:
    """Finds nothing, and takes no frames that are a second or more apart."""

    def __init__(self, options, earlier):
        pass

    def warm_up(self, shape, interval_s, n_frames, progress):
        if interval_s >= 1.0:
            raise ParameterError(f'the interval is {interval_s:g} s')
        return 10.0

    def process(self, batch, progress):
        return DetectionResult([], 10.0, 'converged')

    def reset(self):
        pass


@pytest.fixture
def stream():
    warnings = []
    started = StreamWorker(
        DetectorOptions(batch_length=4), SETTINGS, on_result=lambda result: None,
        on_reset=lambda: None, on_state=lambda: None,
        on_warning=lambda kind, text: warnings.append(text), make_pipeline=Pipeline)
    started.warnings = warnings
    started.start()
    yield started
    assert started.stop(TIMEOUT_S)


def feed(stream, stamps, shape=(3, 5)):
    """Hand frames over, and wait until they were taken."""
    for stamp in stamps:
        stream.queue.put(np.zeros(shape, np.float32), stamp, None)
    end_s = time.monotonic() + TIMEOUT_S
    while stream.queue.counters.used < stream.queue.counters.received and time.monotonic() < end_s:
        time.sleep(0.005)
    assert stream.queue.counters.used == stream.queue.counters.received


def wait_for_batches(stream, n_batches):
    end_s = time.monotonic() + TIMEOUT_S
    while stream.queue.counters.batches < n_batches and time.monotonic() < end_s:
        time.sleep(0.005)
    assert stream.queue.counters.batches == n_batches


def test_a_first_stamp_of_zero_does_not_spoil_the_preparation(stream):
    feed(stream, [0.0, *(1.7e9 + 0.25 * np.arange(4))])
    wait_for_batches(stream, 1)
    assert stream.queue.counters.failures == 0
    assert 'found a gap of 1.7e+09 s' in stream.warnings[0]


def test_a_failed_preparation_is_tried_again_when_the_stream_starts_again(stream):
    feed(stream, 2.0 * np.arange(8))
    assert stream.queue.counters.failures == 1
    assert stream.status.state == 'failed'
    feed(stream, 1000.0 + 0.25 * np.arange(4))
    wait_for_batches(stream, 1)
    assert stream.status.state == 'ready'


def test_the_size_shown_is_that_of_the_frames_searched(stream):
    feed(stream, 0.25 * np.arange(4))
    wait_for_batches(stream, 1)
    feed(stream, 100.0 + 2.0 * np.arange(4), shape=(6, 7))
    feed(stream, 200.0 + 0.25 * np.arange(4))
    wait_for_batches(stream, 2)
    assert stream.status.shape == (3, 5)
