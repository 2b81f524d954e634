"""Bearing goes round: a target at the seam is like any other."""

import numpy as np
import pytest

from false_alarms import assert_rate_is_realised
import track_before_detect as tbd
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.tracking.pipeline import TrackingPipeline

WIDTH, HEIGHT = 90, 48


def maps(courses, snr, seed=None, n_frames=12):
    """Return maps of targets at x, y (T, 2), x of any turn; without a seed there is no noise."""
    frames = np.zeros((n_frames, HEIGHT, WIDTH), np.float32)
    if seed is not None:
        frames += np.random.default_rng(seed).standard_normal(frames.shape, dtype=np.float32)
    for course in courses:
        for frame, (x, y) in zip(frames, course, strict=True):
            for turn in (-1, 0, 1):
                add_target(frame, x % WIDTH + turn * WIDTH, y, 1.0, snr)
    return frames


def past_the_sensor(n_frames=12, closest=22.0, speed=0.5, bearing=0.0):
    """Return bearing column and range row of a straight course over the plane, passing by."""
    along = speed * (np.arange(n_frames) - 0.5 * (n_frames - 1))
    turn = np.arctan2(along, closest) / (2 * np.pi) * WIDTH
    return np.stack([bearing + turn, np.hypot(along, closest)], axis=1)


def apart(found, course):
    """Return the distance in each frame, the shorter way round."""
    across = (found[:, 0] - course[:, 0] + WIDTH / 2) % WIDTH - WIDTH / 2
    return np.hypot(across, found[:, 1] - course[:, 1])


@pytest.mark.parametrize('bearing', [0.0, -0.4, 1.5, 45.0, 88.0])
def test_target_without_noise_is_found_once_wherever_the_seam(bearing):
    course = past_the_sensor(bearing=bearing)
    [trajectory] = tbd.detect(maps([course], 20.0), motion_model='range_bearing',
                              threshold=8).trajectories
    # A straight line over the map explains this course to a tenth of a bin, and is preferred.
    assert apart(trajectory.positions, course).max() < 0.2
    assert (trajectory.positions[:, 0] >= -0.5).all()
    assert (trajectory.positions[:, 0] < WIDTH - 0.5).all()
    np.testing.assert_allclose(trajectory.velocity, np.gradient(course, axis=0), atol=0.1)
    np.testing.assert_allclose(trajectory.amplitudes, 20.0, rtol=0.1)


def test_result_does_not_depend_on_where_the_seam_is():
    courses = [past_the_sensor(bearing=2.0), past_the_sensor(bearing=40.0, closest=30.0)]
    frames = maps(courses, 5.0, seed=4)
    options = {'motion_model': 'range_bearing', 'threshold': 7.5}
    here = tbd.detect(frames, **options).trajectories
    there = tbd.detect(np.roll(frames, 37, axis=2), **options).trajectories
    assert len(here) == len(there) >= 2
    for a, b in zip(here, there, strict=True):
        assert a.statistic == pytest.approx(b.statistic, rel=1e-3)
        assert apart(a.positions + (37, 0), b.positions).max() < 0.1


def test_target_over_the_seam_keeps_its_id_over_batches():
    course = past_the_sensor(n_frames=30, bearing=0.0)
    result = tbd.detect(maps([course], 8.0, seed=1, n_frames=30), motion_model='range_bearing',
                        threshold=8, batch_length=10, hop=5)
    assert len(result.trajectories) == 1
    assert np.nanmax(apart(result.trajectories[0].positions, course)) < 1.5


def test_realised_rate_in_noise_is_the_requested_one(calibrate_on):
    calibrate_on(400)
    n_runs, rate, shape = 200, 0.3, (32, 160)
    detector = ConvexDetector(DetectorOptions(
        psf_sigma_px=2.0, motion_model='range_bearing', false_alarm_rate=rate))
    stamps = np.arange(6.0)
    bound = detector.threshold(stamps, shape)
    search = detector.noise_study(stamps, shape).searcher(shape)
    assert_rate_is_realised(lambda generator: search(generator) > bound, rate, n_runs, 12)


def test_no_path_leaves_at_the_sides_of_a_round_frame():
    graph = build_state_graph(np.arange(9.0), step_px=1.0, max_speed=1.0, max_acceleration=0.0,
                              turn_cost=0.0)
    assert graph.effective_area((1000, 20), around=True) == pytest.approx(
        graph.effective_area((1000, 20 + 10**6)) * 20 / 10**6, rel=1e-3)
    assert graph.effective_area((1000, 20)) < graph.effective_area((1000, 20), around=True)


def test_registration_is_refused():
    with pytest.raises(tbd.ParameterError, match='=translation with motion_model=range_bearing'):
        tbd.detect(np.zeros((4, 16, 16)), motion_model='range_bearing', threshold=8,
                   registration='translation')


def test_frames_narrower_than_the_stamp_are_refused():
    options = {'motion_model': 'range_bearing', 'threshold': 8}
    with pytest.raises(tbd.ParameterError, match='range_bearing needs frames with at least 9 '
                                                 'columns, .* got 8'):
        tbd.detect(np.zeros((4, 16, 8)), **options)
    assert tbd.detect(np.zeros((4, 16, 9)), **options).trajectories == []


def test_warm_up_does_for_any_psf_that_the_frames_are_wide_enough_for():
    psf = np.outer(np.hanning(31), np.hanning(31))
    pipeline = TrackingPipeline(DetectorOptions(
        psf=psf, motion_model='range_bearing', threshold=9.0))
    assert pipeline.warm_up((40, 64), 1.0, 4) == 9.0


def test_masked_pixels_and_variance_go_round_with_the_columns():
    course = past_the_sensor(bearing=1.0)
    frames = maps([course], 8.0, seed=3)
    frames[4:6, :, -5:] = np.nan
    variance = np.full((HEIGHT, WIDTH), 1.0)
    [trajectory] = tbd.detect(frames, motion_model='range_bearing', threshold=8,
                              variance=variance).trajectories
    assert apart(trajectory.positions, course).max() < 1.0
