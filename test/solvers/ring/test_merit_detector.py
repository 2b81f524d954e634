"""The detectors of the Ring paper: what they find, what they refuse, what they promise."""

import numpy as np
import pytest

from track_before_detect import detect
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.ring.merit_detector import MeritDetector
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.types import FrameBatch


def gaussian_frames(seed, trajectories, snr, shape=(48, 48), sigma=1.0):
    """Return frames of unit noise with targets of a matched filter statistic ``snr``."""
    frames = np.random.default_rng(seed).standard_normal((len(trajectories[0]), *shape))
    y, x = np.mgrid[:shape[0], :shape[1]]
    for positions in trajectories:
        for frame, (at_x, at_y) in zip(frames, positions, strict=True):
            stamp = np.exp(-((x - at_x)**2 + (y - at_y)**2) / (2 * sigma**2))
            frame += snr * stamp / np.linalg.norm(stamp)
    return frames.astype(np.float32)


def line(start, velocity, n_frames):
    return np.array(start) + np.outer(np.arange(n_frames), velocity)


def detector(**settings):
    return MeritDetector(DetectorOptions(**{'detector': 'mff_dpr', 'threshold': 10.0, **settings}))


PAIR = [line((8, 10), (0.7, 0.3), 20), line((40, 12), (-0.5, 0.8), 20)]


@pytest.mark.parametrize('method', METHODS)
def test_two_bright_targets_are_found_once_each(method):
    found = detector(detector=method).detect(FrameBatch.of(gaussian_frames(1, PAIR, 9))).found
    assert len(found) == 2
    nearest = [[np.nanmean(np.linalg.norm(one.positions - truth, axis=1)) for truth in PAIR]
               for one in found]
    assert sorted(np.argmin(nearest, axis=1)) == [0, 1]
    assert np.max(np.min(nearest, axis=1)) < 1


def test_statistic_is_the_sum_over_the_root_of_the_frames_and_above_the_threshold():
    result = detector(threshold=12.0).detect(FrameBatch.of(gaussian_frames(2, PAIR, 5)))
    for one in result.found:
        assert one.statistic == pytest.approx(np.nansum(one.amplitudes) / np.sqrt(20))
        assert one.statistic > result.threshold == 12.0
    assert len(result.found) == 2
    assert result.status == 'converged'


def test_amplitude_is_that_of_the_unit_norm_psf():
    [one] = detector().detect(FrameBatch.of(gaussian_frames(3, PAIR[:1], 20))).found
    assert one.snr == pytest.approx(20 * np.exp(-1 / 24), rel=0.05)


@pytest.mark.parametrize('masked', [False, True])
def test_statistic_has_unit_variance_up_to_the_border_and_beside_a_mask(masked):
    frames = np.random.default_rng(4).standard_normal((4000, 9, 10)).astype(np.float32)
    if masked:
        frames[:, 3:5, 4] = np.nan
    seen = detector().statistics(frames)
    np.testing.assert_allclose(seen.std(axis=0), 1, atol=0.06)


def test_pixels_are_accumulated_as_they_are_when_the_psf_is_one_pixel():
    frames = np.random.default_rng(5).standard_normal((3, 9, 10)).astype(np.float32)
    np.testing.assert_allclose(detector(psf_sigma_px=0.3).statistics(frames), frames, rtol=1e-5)


def test_dropped_frames_are_put_in():
    kept = np.delete(np.arange(24), [5, 6, 13])
    frames = gaussian_frames(6, [line((8, 10), (1, 0.6), 24)], 8)[kept]
    [one] = detector().detect(FrameBatch.of(frames, kept / 25.0)).found
    truth = line((8, 10), (1, 0.6), 24)[kept]
    assert one.positions.shape == (21, 2)
    assert np.nanmax(np.abs(one.positions - truth)) <= 1.5
    assert one.statistic == pytest.approx(np.nansum(one.amplitudes) / np.sqrt(21))


def test_absent_frames_are_nan_in_the_trajectory():
    track = line((8, 10), (0.7, 0.3), 24)
    frames = gaussian_frames(7, [track], 10)
    frames[14:] = np.random.default_rng(8).standard_normal((10, 48, 48))
    [one] = detect(frames, detector='cfo_dpr', threshold=10.0).trajectories
    assert np.isfinite(one.positions[2:14]).all()
    absent = np.isnan(one.positions[:, 0])
    assert np.isnan(one.amplitudes[absent]).all() and np.isnan(one.velocity[absent]).all()
    assert np.isfinite(one.velocity[~absent]).all()


def test_speed_is_counted_in_pixels_per_interval():
    stamps = np.arange(20) / 10.0
    assert detector()._v_max(stamps, (48, 48)) == 1
    assert detector(max_speed_px_s=10.0)._v_max(stamps, (48, 48)) == 1
    assert detector(max_speed_px_s=10.1)._v_max(stamps, (48, 48)) == 2
    assert detector(motion_model='static')._v_max(stamps, (48, 48)) == 0


@pytest.mark.parametrize('method, v_max', [('cfo_dp', 3), ('mff_dp', 3)])
def test_faster_targets_are_found_where_the_speed_allows(method, v_max):
    frames = gaussian_frames(9, [line((3, 8), (2.6, 1.4), 16)], 9)
    found = detector(detector=method, max_speed_px_s=3.0).detect(FrameBatch.of(frames)).found
    assert found and np.isfinite(found[0].positions).all()


@pytest.mark.parametrize('settings, words', [
    ({'amplitudes': 'signed'}, 'amplitudes=signed, only non-negative: .* largest sums'),
    ({'motion_model': 'constant_velocity'}, 'motion_model=constant_velocity, only .* or static'),
    ({'max_acceleration_px_s2': 1.0}, 'max_acceleration_px_s2=1, only automatic: .* the speed'),
    ({'noise': 'map'}, 'noise=map, only none or robust: it does not weigh pixels'),
], ids=['signed', 'constant velocity', 'acceleration', 'noise of each pixel'])
def test_options_that_cannot_be_met_are_refused(settings, words):
    with pytest.raises(ParameterError, match=words):
        detector(**settings)


@pytest.mark.parametrize('stamps, words', [
    (np.array([0, 1, 2, 3.4, 4]), 'equal intervals, .* got 1.4 median intervals before frame 3'),
    (np.array([0, 1, 2, 12, 13]), 'most frames of a batch, got 5 of 14'),
    (np.arange(2), 'at least 3 frames, got 2'),
], ids=['uneven', 'mostly dropped', 'too few'])
def test_stamps_that_cannot_be_searched_are_refused(stamps, words):
    frames = np.zeros((len(stamps), 16, 16), np.float32)
    with pytest.raises(DataError, match=words):
        detector().detect(FrameBatch.of(frames, stamps.astype(float)))


def test_complex_frames_are_refused():
    with pytest.raises(DataError, match='frames of complex numbers need amplitudes complex'):
        detector().detect(FrameBatch.of(np.zeros((5, 16, 16), np.complex64)))


def test_frames_smaller_than_what_is_filled_are_refused():
    with pytest.raises(DataError, match='frames must be as large, got 80 x 1'):
        detector().detect(FrameBatch.of(np.zeros((5, 1, 80), np.float32)))


def test_second_order_refuses_speeds_beyond_its_candidates():
    with pytest.raises(ParameterError, match='up to 7 pixels per frame interval, and .* 7.5'):
        detector(max_speed_px_s=7.5).detect(FrameBatch.of(np.zeros((5, 16, 16), np.float32)))


@pytest.mark.parametrize('method', ['cfo_dp', 'mff_dpr'])
def test_noise_yields_trajectories_at_the_requested_rate(method, calibrate_on):
    # Fewer crops than a user's calibration takes, in a cache of their own.
    calibrate_on(600)
    settings = DetectorOptions(detector=method, false_alarm_rate=0.2, psf_sigma_px=1.0)
    searched = MeritDetector(settings)
    noise = np.random.default_rng(10)
    n_batches = 150
    false_alarms = sum(
        bool(searched.detect(FrameBatch.of(noise.standard_normal((12, 24, 24)).astype(np.float32),
                             np.arange(12.0))).found) for _ in range(n_batches))
    # Four standard deviations of the count and of the calibration.
    assert abs(false_alarms / n_batches - 0.2) < 4 * np.sqrt(0.2 * 0.8 * (1 / n_batches + 1 / 600))
