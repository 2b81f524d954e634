"""A batch ends when its time is up, with what was found by then, and shows that it goes on."""

import time

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.watch import PERIOD_S, Watch
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch

# Noise of twice the deviation that is told makes hundreds of overlapping paths.
THRESHOLD, SHAPE = 9.0, (20, 96, 96)
STOPPABLE = {'convex': THRESHOLD, 'greedy': THRESHOLD, 'velocity_filter': 4.0}


def hairball(seed=0):
    """Return frames with no end of paths above the threshold, and the track of one target."""
    frames = 2.0 * np.random.default_rng(seed).standard_normal(SHAPE).astype(np.float32)
    truth = np.column_stack([30 + 0.4 * np.arange(SHAPE[0]), np.full(SHAPE[0], 50.0)])
    for frame, (x, y) in zip(frames, truth, strict=True):
        add_target(frame, x, y, 1.0, 30.0)
    return frames, truth


@pytest.mark.parametrize('detector', STOPPABLE)
def test_a_batch_without_end_is_left_in_time_with_what_was_found(detector):
    frames, truth = hairball()
    pipeline = TrackingPipeline(DetectorOptions(
        detector=detector, threshold=STOPPABLE[detector], max_time_s=1.0))
    # Loops that have to be compiled or loaded are no part of the search.
    for _ in range(2):
        # Of this thread alone: beside other work the clock on the wall goes on meanwhile.
        begun = time.thread_time()
        result = pipeline.process(FrameBatch.of(frames))
        took_s = time.thread_time() - begun
    assert took_s < 2.0
    assert result.status == 'time_limit'
    best = result.trajectories[0]
    assert np.median(np.hypot(*(best.positions - truth).T)) < 1.0
    assert min(one.statistic for one in result.trajectories) > STOPPABLE[detector]


def test_a_batch_that_carries_on_many_paths_is_left_in_time():
    frames, _ = hairball()
    pipeline = TrackingPipeline(DetectorOptions(threshold=THRESHOLD, max_time_s=1.0))
    stamps = np.arange(float(SHAPE[0]))
    result = pipeline.process(FrameBatch.of(frames, stamps))
    # The first that carries paths on may have to load the loops for it.
    for n_shifted in (5, 10):
        many = result.trajectories
        begun = time.thread_time()
        result = pipeline.process(FrameBatch.of(np.roll(frames, -n_shifted, axis=0),
                                                stamps + n_shifted))
        took_s = time.thread_time() - begun
    assert took_s < 2.0
    assert result.status == 'time_limit'
    assert {one.id for one in many} & {one.id for one in result.trajectories}


@pytest.mark.parametrize('options', [
    {}, {'continuation': (1.0,)}, {'amplitude_model': 'constant'}, {'presence': 'partial'}])
def test_no_time_at_all_is_a_result_too(options):
    frames, _ = hairball()
    result = tbd.detect(frames, threshold=THRESHOLD, max_time_s=1e-9, **options)
    assert (result.status, result.trajectories) == ('time_limit', [])
    assert np.isnan(result.gap)


def test_dynamic_programming_stops_after_the_trajectory_at_hand():
    frames, _ = hairball()
    result = tbd.detect(frames, detector='mff_dp', threshold=3.0, max_time_s=1e-9)
    assert (result.status, len(result.trajectories)) == ('time_limit', 1)


@pytest.mark.parametrize('detector', [*STOPPABLE, 'mff_dp'])
def test_a_limit_that_is_not_reached_changes_nothing(detector):
    frames = np.random.default_rng(3).standard_normal((8, 24, 30)).astype(np.float32)
    for t, frame in enumerate(frames):
        add_target(frame, 6 + 0.9 * t, 10.0, 1.0, 8.0)
        add_target(frame, 13 - 0.9 * t, 12.0, 1.0, 8.0)
    free, limited = (tbd.detect(frames, detector=detector, threshold=8.0, **options)
                     for options in ({}, {'max_time_s': 1000.0}))
    assert free.status == limited.status == 'converged'
    assert len(free.trajectories) == len(limited.trajectories) > 0
    for one, other in zip(free.trajectories, limited.trajectories, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_array_equal(one.amplitudes, other.amplitudes)


@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_a_long_search_tells_that_it_goes_on(detector):
    frames, _ = hairball()
    pipeline = TrackingPipeline(DetectorOptions(
        detector=detector, threshold=THRESHOLD, max_time_s=3.0))
    pipeline.warm_up(SHAPE[1:], 1.0, SHAPE[0])
    told = []
    pipeline.process(FrameBatch.of(frames), lambda *what: told.append((*what, time.monotonic())))
    assert {label for label, *_ in told} == {'searching'}
    shares = [share for _, share, _ in told]
    assert shares == sorted(shares) and 0 < shares[-1] <= 1
    assert np.median(np.diff([moment for *_, moment in told])) < 1.0


def test_a_watch_is_patient_without_a_limit_and_speaks_now_and_then():
    told = []
    watch = Watch(progress=lambda *what: told.append(what))
    watch.begin_stage(1, 4)
    watch.end_round()
    until = time.monotonic() + 2.5 * PERIOD_S
    while time.monotonic() < until:
        assert not watch.time_is_up()
        time.sleep(0.01)
    assert told == [('searching', 0.375)] * 2
    assert watch.status('converged') == 'converged' and not watch.is_limited
