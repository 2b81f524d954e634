"""A batch is told where the one before saw targets, in its own pixels, and is not misled."""

from dataclasses import replace

import numpy as np
import pytest

from track_before_detect import geometry, Sensor
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.previous_batch import map_previous_batch
from track_before_detect.tracking.sensor_pipeline import SensorPipeline
from track_before_detect.tracking.sensors import SensorArray
from track_before_detect.types import FrameBatch, Trajectory

LENGTH, HOP = 14, 7


class Spy(ConvexDetector):
    """Keeps what each batch was told and what it found."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.seen = []

    def detect(self, batch, weights=None, earlier=None, progress=None):
        result = super().detect(batch, weights, earlier, progress)
        self.seen.append((earlier, result.found))
        return result


class Forgetful(ConvexDetector):
    """Begins every batch afresh."""

    def detect(self, batch, weights=None, earlier=None, progress=None):
        return super().detect(batch, weights, None, progress)


def batches(frames, hop=HOP):
    stamps = np.arange(float(len(frames)))
    for start in range(0, len(frames) - LENGTH + 1, hop):
        rows = np.arange(start, start + LENGTH)
        yield FrameBatch(frames[rows], stamps[rows], rows)


def told_and_found(seen):
    """Return the distance of what each batch after the first was told from what it found."""
    distances = []
    for earlier, found in seen[1:]:
        for positions in earlier.positions:
            off = [np.hypot(*(positions - one.positions)[earlier.known].T) for one in found]
            distances.append(min(np.nanmax(one) for one in off))
    return distances


def test_positions_of_the_common_frames_are_taken_to_the_plane_of_the_batch():
    rng = np.random.default_rng(1)
    maps = geometry.translations(rng.uniform(-9, 9, (6, 2)))
    maps[:, 0, 1] = 0.02
    on_plane = rng.uniform(0, 30, (6, 2))
    own = np.full((8, 2), np.nan)
    own[4:] = geometry.apply(maps, on_plane)[:4]
    own[5] = np.nan
    before = Trajectory(3, own, np.ones(8), np.zeros((8, 2)), np.arange(8.0), np.arange(8), 9, 3)
    earlier = map_previous_batch([before], np.arange(4, 10), maps)
    assert earlier.known.tolist() == [True] * 4 + [False] * 2
    [positions] = earlier.positions
    np.testing.assert_allclose(positions[[0, 2, 3]], on_plane[[0, 2, 3]])
    assert np.isnan(positions[[1, 4, 5]]).all()
    assert map_previous_batch([before], np.arange(8, 14), maps) is None
    assert map_previous_batch([], np.arange(6), maps) is None


def test_a_batch_of_a_moving_camera_is_told_in_its_own_plane():
    rng = np.random.default_rng(2)
    scene = rng.normal(0, 6, (90, 120))
    frames = rng.normal(0, 0.5, (28, 50, 60)).astype(np.float32)
    for t, frame in enumerate(frames):
        # A camera that pans: the plane of every batch is that of another frame.
        frame += scene[20 + t // 2:70 + t // 2, 10 + t:70 + t]
        add_target(frame, 40 - 0.4 * t, 25 - 0.2 * t, 1.0, 12.0)
    options = DetectorOptions(registration='translation', background='temporal_median',
                              noise='robust', threshold=25.0)
    spy = Spy(options)
    pipeline = TrackingPipeline(options, detector=spy)
    for batch in batches(frames):
        pipeline.process(batch)
    distances = told_and_found(spy.seen)
    assert len(distances) >= 2
    assert max(distances) < 1.0


def test_sensors_are_told_on_their_common_plane():
    rng = np.random.default_rng(3)
    frames = rng.standard_normal((28, 30, 34)).astype(np.float32)
    for t, frame in enumerate(frames):
        add_target(frame, 8 + 0.6 * t, 12.0, 1.0, 7.0)
    shifted = [[1.0, 0, -5], [0, 1, 7]]
    options = DetectorOptions(threshold=12.0)
    array = SensorArray([Sensor(frames, np.arange(28.0), affine=shifted)], options)
    spy = Spy(options, array.plane.measurement)
    pipeline = SensorPipeline(array.plane, options, detector=spy)
    for batch in batches(frames):
        pipeline.process(replace(batch, taken=array.taken[batch.frame_indices]))
    distances = told_and_found(spy.seen)
    assert len(distances) == 2
    assert max(distances) < 1.0


@pytest.mark.parametrize('presence', ['full', 'partial'])
@pytest.mark.parametrize('seed', [1, 2])
def test_a_stream_gives_what_its_batches_give_alone(seed, presence):
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal((49, 40, 40)).astype(np.float32)
    for t, frame in enumerate(frames):
        add_target(frame, 5 + 0.6 * t, 30 - 0.4 * t, 1.0, 4.0)
        if t < 20:
            add_target(frame, 30 - 0.5 * t, 33.0, 1.0, 5.0)
    # So low that noise passes at times.
    options = DetectorOptions(threshold=7.0 if presence == 'full' else 7.4, presence=presence)
    warm = TrackingPipeline(options)
    together = [warm.process(batch).trajectories for batch in batches(frames)]
    cold = TrackingPipeline(options, detector=Forgetful(options))
    alone = [cold.process(batch).trajectories for batch in batches(frames)]
    for first, second in zip(together, alone, strict=True):
        assert len(first) == len(second)
        for one in second:
            assert min(np.nanmean(np.hypot(*(one.positions - other.positions).T))
                       for other in first) < 0.5


def test_after_a_reset_a_batch_is_told_nothing():
    frames = np.random.default_rng(4).standard_normal((28, 30, 30)).astype(np.float32)
    for frame in frames:
        add_target(frame, 15.0, 15.0, 1.0, 7.0)
    options = DetectorOptions(threshold=12.0)
    spy = Spy(options)
    pipeline = TrackingPipeline(options, detector=spy)
    for batch in batches(frames):
        pipeline.process(batch)
        pipeline.reset()
    assert [earlier for earlier, _ in spy.seen] == [None] * 3
