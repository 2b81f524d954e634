"""The search thread with a pipeline of the test's own; nothing is sent."""

from copy import copy
import threading
import time

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import usable_cores
from track_before_detect.ros.frame_queue import StreamRequest
from track_before_detect.ros.worker import StreamWorker
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import DetectionResult, FrameBatch

TIMEOUT_S = 60.0
PLAIN = {'batch_length': 4, 'hop': 4}


# Widths of the PSF that take until PREPARES is set to prepare, and that never can be.
SLOW_PX, BROKEN_PX = 5.0, 6.0
PREPARES = threading.Event()


class Pipeline:
    """Finds nothing, and takes no frames that are a second or more apart."""

    def __init__(self, options, earlier):
        self.options = options

    def compile(self, progress):
        pass

    def warm_up(self, shape, interval_s, n_frames, progress):
        if interval_s >= 1.0:
            raise ParameterError(f'the interval is {interval_s:g} s')
        if self.options.psf_sigma_px == BROKEN_PX:
            raise ParameterError('this width cannot be prepared')
        while self.options.psf_sigma_px == SLOW_PX and not PREPARES.wait(0.01):
            progress('calibrating', 0.5)
        return self.options.threshold or 10.0

    def prepare(self, batch, progress):
        return lambda progress: DetectionResult([], self.options.threshold or 10.0, 'converged')

    def reset(self):
        pass


@pytest.fixture
def start():
    """Start workers, and end them with the test."""
    workers = []
    PREPARES.clear()

    def start_worker(preset, told, make_pipeline=Pipeline, **expected):
        warnings, results, choices = [], [], []
        started = StreamWorker(
            StreamRequest(preset, told, queue_length=100), on_result=results.append,
            on_reset=lambda: None, on_state=lambda: None,
            on_choice=lambda: choices.append(started.status.reasons),
            on_warning=lambda kind, text: warnings.append(text), make_pipeline=make_pipeline,
            **expected)
        started.warnings, started.results, started.choices = warnings, results, choices
        workers.append(started)
        started.start()
        return started

    yield start_worker
    for worker in workers:
        assert worker.stop(TIMEOUT_S)


@pytest.fixture
def stream(start):
    return start('none', PLAIN)


def feed(stream, stamps, shape=(3, 5), make=np.zeros):
    """Hand frames over, and wait until all are used or refused."""
    for stamp in stamps:
        stream.queue.put(make(shape).astype(np.float32), stamp, None)
    counters = stream.queue.counters
    end_s = time.monotonic() + TIMEOUT_S
    while counters.used + counters.refused < counters.received and time.monotonic() < end_s:
        time.sleep(0.005)
    assert counters.used + counters.refused == counters.received


def wait_for(condition):
    end_s = time.monotonic() + TIMEOUT_S
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.005)
    assert condition()


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


def test_a_stream_goes_on_after_frames_that_are_ages_apart(stream):
    feed(stream, [100.0, 1e10])
    feed(stream, 1000.0 + 0.25 * np.arange(5))
    wait_for(lambda: stream.queue.counters.batches >= 1)
    assert stream.status.state == 'ready'


def test_whoever_waits_for_the_preparation_is_told_how_it_went(start):
    expected = {'expected_shape': (3, 5), 'expected_interval_s': 0.1}
    worker = start('none', PLAIN, **expected)
    assert worker.wait_until_prepared() and worker.status.state == 'ready'
    worker = start('none', PLAIN)
    assert worker.wait_until_prepared() and worker.status.state == 'waiting for frames'
    worker = start('none', {**PLAIN, 'psf_sigma_px': BROKEN_PX}, **expected)
    assert not worker.wait_until_prepared() and worker.status.state == 'failed'
    worker = start('none', {**PLAIN, 'psf_sigma_px': SLOW_PX}, **expected)
    worker.queue.close()
    assert not worker.wait_until_prepared()


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


def test_frames_whose_stamp_is_not_filled_in_are_left_out(stream):
    stamps = 1.7e9 + 0.1 * np.arange(41)
    stamps[5::10] = 0.0
    feed(stream, stamps)
    wait_for_batches(stream, 9)
    counters = stream.queue.counters
    assert (counters.refused, counters.used, counters.restarts) == (4, 37, 0)
    assert 'stamped 0.000000 s' in stream.warnings[0]


@pytest.mark.parametrize('every', [2, 3, 7])
def test_frames_that_are_left_out_take_the_place_of_none_in_a_batch(start, every):
    stream = start('none', {**PLAIN, 'batch_length': 20, 'hop': 10})
    # As of a second publisher whose clock is behind.
    stamps = [stamp for k in range(60) for stamp in (
        100.0 + 0.1 * k, *([90.0 + 0.1 * k] if k > 0 and k % every == 0 else []))]
    feed(stream, stamps)
    wait_for_batches(stream, 5)
    assert stream.status.state == 'ready' and stream.queue.counters.failures == 0


def test_both_frames_that_show_a_loop_are_used(stream):
    feed(stream, 0.25 * np.arange(8))
    feed(stream, 0.25 * np.arange(8))
    wait_for_batches(stream, 4)
    assert stream.queue.counters.restarts == 1
    assert [r.batch.frame_indices.tolist() for r in stream.results[2:]] == [
        [8, 9, 10, 11], [12, 13, 14, 15]]


def scene(shape):
    """Return a picture that stands still, and noise that does not."""
    ramp = np.add.outer(np.sin(np.arange(shape[0])), np.cos(np.arange(shape[1])))
    return 1000 + 200 * ramp + RNG.standard_normal(shape)


RNG = np.random.default_rng(3)


def test_a_scene_is_looked_at_and_its_frames_are_searched_in_the_batches_chosen(start):
    stream = start('auto', {})
    feed(stream, 0.1 * np.arange(19), (24, 32), scene)
    assert stream.status.state == 'looking at the first frames'
    assert stream.status.detail == '19 of 20'
    assert not stream.queue.counters.batches
    feed(stream, 0.1 * np.arange(19, 32), (24, 32), scene)
    wait_for_batches(stream, 3)
    assert stream.status.options.background != 'none'
    assert stream.status.options.batch_length == 16
    assert stream.status.state == 'ready' and stream.status.preset == 'auto'
    assert [r.batch.frame_indices[0] for r in stream.results] == [0, 8, 16]
    assert {(len(r.batch), r.hop) for r in stream.results} == {(16, 8)}
    assert stream.choices == [stream.status.reasons] and stream.choices[0]


def test_what_was_told_wins_over_what_is_chosen(start):
    stream = start('auto', {'noise': 'robust', **PLAIN})
    feed(stream, 0.1 * np.arange(8), (24, 32), scene)
    wait_for_batches(stream, 2)
    options = stream.status.options
    assert options.background != 'none'
    assert (options.noise, options.batch_length, options.hop) == ('robust', 4, 4)


def test_frames_of_unit_noise_come_out_as_without_a_preset(start):
    results = []
    for preset in ('none', 'auto'):
        generator = np.random.default_rng(5)
        stream = start(preset, {})
        feed(stream, 0.1 * np.arange(45), (24, 32), generator.standard_normal)
        wait_for_batches(stream, 3)
        results.append(([r.batch.frame_indices.tolist() for r in stream.results],
                        stream.status.options, copy(stream.queue.counters)))
    assert results[0] == results[1]


def test_a_pause_or_another_size_is_looked_at_again_and_a_loop_is_not(start):
    stream = start('auto', {'batch_length': 8, 'hop': 8})
    feed(stream, 0.1 * np.arange(8), (24, 32), RNG.standard_normal)
    wait_for_batches(stream, 1)
    assert stream.status.options.background == 'none'
    feed(stream, 1000 + 0.1 * np.arange(8), (24, 32), scene)
    wait_for_batches(stream, 2)
    assert stream.status.options.background != 'none'
    feed(stream, 0.1 * np.arange(8), (24, 32), RNG.standard_normal)
    wait_for_batches(stream, 3)
    assert stream.status.options.background != 'none'
    feed(stream, 1 + 0.1 * np.arange(8), (24, 40), RNG.standard_normal)
    wait_for_batches(stream, 4)
    assert stream.status.options.background == 'none'
    assert len(stream.choices) == 3
    assert [len(r.batch) for r in stream.results] == [8, 8, 8, 8]


def test_the_first_frames_of_a_short_stream_are_searched_when_asked_for(start):
    stream = start('auto', {})
    feed(stream, 0.1 * np.arange(13), (24, 32), scene)
    stream.queue.flush()
    wait_for_batches(stream, 1)
    assert [r.batch.frame_indices[-1] for r in stream.results] == [12]


def test_a_preset_that_is_changed_holds_from_the_next_batch_on(start):
    stream = start('auto', {})
    feed(stream, 0.1 * np.arange(24), (24, 32), scene)
    wait_for_batches(stream, 2)
    stream.queue.configure(StreamRequest('none', PLAIN, queue_length=100))
    wait_for(lambda: stream.status.preset == 'none')
    feed(stream, 2.4 + 0.1 * np.arange(4), (24, 32), scene)
    wait_for_batches(stream, 3)
    assert stream.status.options.background == 'none' and len(stream.results[-1].batch) == 4
    # The first frames are known by now.
    stream.queue.configure(StreamRequest('auto', PLAIN, queue_length=100))
    wait_for(lambda: stream.status.preset == 'auto')
    feed(stream, 2.8 + 0.1 * np.arange(4), (24, 32), scene)
    wait_for_batches(stream, 4)
    assert stream.status.options.background != 'none' and len(stream.results[-1].batch) == 4


def ask(stream, **told):
    stream.queue.configure(StreamRequest('none', {**PLAIN, **told}, queue_length=100))


def test_a_change_that_takes_long_to_prepare_leaves_the_search_going_on_until_it_is_ready(stream):
    feed(stream, 0.25 * np.arange(4))
    ask(stream, psf_sigma_px=SLOW_PX, threshold=20.0)
    wait_for(lambda: stream.status.beside == 'calibrating other options: 50 %')
    feed(stream, 1.0 + 0.25 * np.arange(8))
    wait_for_batches(stream, 3)
    assert [result.detection.threshold for result in stream.results] == [10.0] * 3
    assert stream.status.state == 'ready' and stream.status.options.psf_sigma_px == 1.0
    PREPARES.set()
    wait_for(lambda: stream.status.threshold == 20.0)
    assert stream.status.beside == '' and stream.status.options.psf_sigma_px == SLOW_PX
    feed(stream, 3.0 + 0.25 * np.arange(4))
    wait_for_batches(stream, 4)
    assert stream.results[-1].detection.threshold == 20.0
    counters = stream.queue.counters
    assert (counters.used, counters.dropped, counters.failures) == (16, 0, 0)


def test_what_is_asked_for_meanwhile_takes_the_place_of_a_long_preparation(stream):
    feed(stream, 0.25 * np.arange(4))
    ask(stream, psf_sigma_px=SLOW_PX)
    wait_for(lambda: stream.status.beside)
    ask(stream, threshold=30.0)
    wait_for(lambda: stream.status.threshold == 30.0)
    assert stream.status.options.psf_sigma_px == 1.0


def test_a_change_that_cannot_be_prepared_is_said_and_the_search_goes_on_as_before(stream):
    feed(stream, 0.25 * np.arange(4))
    ask(stream, psf_sigma_px=BROKEN_PX)
    wait_for(lambda: stream.queue.counters.failures)
    assert 'the search goes on as before: ParameterError: this width' in stream.warnings[-1]
    feed(stream, 1.0 + 0.25 * np.arange(4))
    wait_for_batches(stream, 2)
    assert stream.status.state == 'ready' and stream.status.options.psf_sigma_px == 1.0


def test_of_options_that_change_all_the_time_some_take_effect_and_every_frame_is_used(stream):
    feed(stream, 0.25 * np.arange(4))
    thresholds = set()
    for k in range(100):
        ask(stream, threshold=20.0 + k)
        stream.queue.put(np.zeros((3, 5), np.float32), 1.0 + 0.25 * k, None)
        thresholds.add(stream.status.threshold)
        time.sleep(0.01)
    wait_for(lambda: stream.status.threshold == 119.0)
    assert len(thresholds) > 3
    wait_for(lambda: stream.queue.counters.used == 104)
    assert stream.queue.counters.batches == 26


class Overlapping(Pipeline):
    """Searches each batch for as long as the next is not prepared, and may not be interrupted."""

    def __init__(self, options, earlier):
        super().__init__(options, earlier)
        self.prepared, self.let_go = [threading.Event() for _ in range(4)], threading.Event()
        self.ahead = []

    def prepare(self, batch, progress):
        number = batch.frame_indices[0] // 4
        self.prepared[number].set()

        def search(progress):
            self.ahead.append(number == 3 or self.prepared[number + 1].wait(TIMEOUT_S))
            # That after the next is not: one is held beside the one that is searched.
            if number < 2:
                self.ahead.append(not self.prepared[number + 2].wait(0.05))
            return super(Overlapping, self).prepare(batch, progress)(progress)

        return search


@pytest.mark.skipif(usable_cores() == 1, reason='a single core')
def test_the_next_batch_is_prepared_while_one_is_searched_and_results_keep_their_order(start):
    pipelines = []

    def make(options, earlier):
        pipelines.append(Overlapping(options, earlier))
        return pipelines[-1]

    worker = start('none', PLAIN, make)
    feed(worker, 0.25 * np.arange(16))
    wait_for_batches(worker, 4)
    assert pipelines[0].ahead == [True] * 6
    assert [r.batch.frame_indices[0] for r in worker.results] == [0, 4, 8, 12]


def test_frames_that_wait_give_what_batches_one_after_the_other_give(start, moving_target):
    frames, _ = moving_target(40)
    frames = 100 + 5 * frames + 50 * scene(frames.shape[1:]).astype(np.float32)
    told = {'batch_length': 8, 'hop': 4, 'threshold': 9.0, 'background': 'temporal_median',
            'noise': 'robust'}
    worker = start('none', told, TrackingPipeline)
    for k, frame in enumerate(frames):
        worker.queue.put(frame, 0.1 * k, None)
    wait_for_batches(worker, 9)
    alone = TrackingPipeline(DetectorOptions(**told))
    found = 0
    for number, result in enumerate(worker.results):
        rows = np.arange(4 * number, 4 * number + 8)
        expected = alone.process(FrameBatch(frames[rows], 0.1 * rows, rows))
        pairs = list(zip(result.detection.trajectories, expected.trajectories, strict=True))
        found += len(pairs)
        for one, other in pairs:
            assert (one.id, one.statistic) == (other.id, other.statistic)
            np.testing.assert_array_equal(one.positions, other.positions)
    assert found > 4


class Endless(Pipeline):
    """Searches until it is told to stop."""

    def prepare(self, batch, progress):
        def search(progress):
            while True:
                progress('searching', 0.5)
                time.sleep(0.001)

        return search


def test_a_stop_ends_the_search_and_what_waits_for_it_at_once(start):
    worker = start('none', PLAIN, Endless)
    for k in range(20):
        worker.queue.put(np.zeros((3, 5), np.float32), 0.25 * k, None)
    wait_for(lambda: worker.queue.counters.used >= 12)
    began_s = time.monotonic()
    assert worker.stop(TIMEOUT_S)
    assert time.monotonic() - began_s < 1.0


def test_a_search_that_fails_is_said_and_the_next_batch_is_searched(start):
    class Broken(Pipeline):
        def prepare(self, batch, progress):
            def search(progress):
                raise SystemError
            return search if batch.frame_indices[0] else super().prepare(batch, progress)

    worker = start('none', PLAIN, Broken)
    feed(worker, 0.25 * np.arange(8))
    wait_for(lambda: worker.queue.counters.failures)
    assert 'SystemError' in worker.warnings[-1]
    feed(worker, 2.0 + 0.25 * np.arange(4))
    wait_for(lambda: worker.queue.counters.failures == 2)
    assert worker.status.state == 'ready' and len(worker.results) == 1
