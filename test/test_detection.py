"""The Python call: its answers to bad input, and its promises about noise and targets."""

import dataclasses
import logging
import re

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.simulation.sensor import add_target

FRAMES = np.random.default_rng(0).standard_normal((4, 16, 16))


@pytest.mark.parametrize(('frames', 'message'), [
    pytest.param(np.zeros((16, 16)), r'shape \(T, H, W\).*\(16, 16\)', id='two dimensions'),
    pytest.param(np.zeros((0, 16, 16)), r'no empty side.*\(0, 16, 16\)', id='no frame'),
    pytest.param(np.full((4, 16, 16), np.nan), 'finite', id='NaN everywhere'),
    pytest.param(np.zeros((4, 16, 16), bool), 'numbers.*bool', id='truth values'),
    pytest.param(np.full((4, 16, 16), 'a'), 'numbers', id='text'),
    pytest.param([[[1, 2], [3]]], 'frames must be an array of numbers', id='ragged'),
    pytest.param(1j * FRAMES, 'amplitudes complex', id='complex'),
])
def test_bad_frames_are_named(frames, message):
    with pytest.raises(tbd.DataError, match=message):
        tbd.detect(frames, threshold=8)


@pytest.mark.parametrize('shape', [(512, 640, 20), (128, 128, 20), (480, 640, 3)])
def test_time_as_the_last_axis_is_refused_and_the_way_out_is_named(shape):
    with pytest.raises(tbd.DataError, match=r'looks like \(H, W, T\): np.moveaxis'):
        tbd.detect(np.zeros(shape, np.uint8), threshold=8)


@pytest.mark.parametrize('shape', [
    (2, 64, 64), (4, 1, 256), (100, 8, 6), (64, 64, 16), (2, 256, 16), (70, 70, 1)])
def test_narrow_small_and_one_dimensional_frames_are_searched(shape):
    assert tbd.detect(np.zeros(shape), threshold=8, max_speed_px_s=0).trajectories == []


@pytest.mark.parametrize('as_list', [False, True])
@pytest.mark.parametrize('dtype', ['u1', 'i4', 'f4'])
def test_what_numpy_masks_is_not_seen(dtype, as_list):
    frames = np.rint(10 * FRAMES).astype(dtype)
    spoilt = np.ma.array(frames, copy=True)
    spoilt[1:3, 4:6, 4:6] = np.ma.masked
    spoilt.data[1:3, 4:6, 4:6] = 120
    unseen = frames.astype(float)
    unseen[1:3, 4:6, 4:6] = np.nan
    given, expected = (tbd.detect(values, noise='robust', threshold=3) for values in (
        list(spoilt) if as_list else spoilt, unseen))
    assert expected.trajectories
    assert [t.statistic for t in given.trajectories] == [
        t.statistic for t in expected.trajectories]
    assert spoilt.data[1, 4, 4] == 120


def test_a_result_prints_a_line_for_each_trajectory():
    frames = np.zeros((5, 32, 32))
    frames[:, 16, 16] = 20.0
    result = tbd.detect(frames, threshold=8)
    head, line = repr(result).splitlines()
    assert head.startswith('DetectionResult(1 trajectories, threshold=8.00, ')
    assert line.strip() == repr(result.trajectories[0])
    assert line.strip().startswith(
        'Trajectory(id=1, frames 0-4, (16.0, 16.0) to (16.0, 16.0) px, 0.00 px/s, snr=')
    many = dataclasses.replace(result, trajectories=result.trajectories * 300)
    assert len(repr(many).splitlines()) == 12 and repr(many).endswith('and 290 more')


@pytest.mark.parametrize(('stamps', 'message'), [
    pytest.param([0.0, 1], r'shape \(4,\).*\(2,\)', id='too few'),
    pytest.param([0.0, 2, 1, 3], 'increase.*2 s.*1 s.*frame 2', id='backward'),
    pytest.param([0.0, 1, 1, 2], 'increase', id='repeated'),
    pytest.param(['a'] * 4, 'stamps must be real numbers', id='text'),
    pytest.param([0.0, 1, np.nan, 2], 'finite.*nan', id='not finite'),
    pytest.param(np.arange(4) + 1j, 'real.*complex128', id='complex'),
    pytest.param(1e-310 * np.arange(4), 'must be 1e-12 to 1e.12 s apart, got', id='too near'),
    pytest.param(1e300 * np.arange(4), 'must be 1e-12 to 1e.12 s apart, got', id='too far'),
])
def test_bad_stamps_are_named(stamps, message):
    with pytest.raises(tbd.DataError, match=message):
        tbd.detect(FRAMES, stamps, threshold=8)


@pytest.mark.parametrize(('options', 'message'), [
    ({'treshold': 8}, "'treshold'.*did you mean threshold"),
    ({'threshold': -1}, 'threshold must be above 0, got -1'),
    ({'threshold': 'high'}, "threshold must be a number, got 'high'"),
    ({'false_alarm_rate': 0.9}, 'at most 0.5, got 0.9'),
    ({'psf_sigma_px': 0}, 'psf_sigma_px must be at least 0.3 px, got 0'),
    ({'motion_model': 'brownian'}, "motion_model must be one of .*'brownian'"),
    ({'continuation': []}, 'continuation must be a list'),
    ({'continuation': [2.0]}, 'continuation must be at most 1, got 2'),
    ({'continuation': [0, 0.5]}, 'continuation must end with its smallest value, .* got 0, 0.5'),
    ({'batch_length': 2.5}, 'batch_length must be a whole number, got 2.5'),
    ({'batch_length': 4, 'hop': 5}, r'hop must be at most batch_length \(4\), got 5'),
    ({'detector': 'conves'}, "detector must be one of .*'conves'.*did you mean convex"),
])
def test_bad_options_are_named(options, message):
    with pytest.raises(tbd.ParameterError, match=message):
        tbd.detect(FRAMES, **options)


@pytest.mark.parametrize(('value', 'words'), [
    (1e9, '1e.08 times their noise, got 1e.09 times'), (-1e30, r'1e\+15, got 1e\+30'),
    (3e38, r'1e\+15, got 3e\+38')])
def test_frame_with_a_pixel_beside_which_the_noise_is_lost_to_rounding_is_masked(value, words):
    frames = np.concatenate([FRAMES, FRAMES[1:]])
    frames[2, 5, 7] = value
    result = tbd.detect(frames, threshold=8)
    [remark] = result.remarks
    assert re.search(f'^frame 2 masked: .*{words}.* in frame 2 at x = 7, y = 5$', remark)
    masked = frames.copy()
    masked[2] = np.nan
    expected = tbd.detect(masked, threshold=8)
    assert [t.positions.tolist() for t in result.trajectories] == [
        t.positions.tolist() for t in expected.trajectories]


@pytest.mark.parametrize('value', [1e9, -1e30])
def test_pixel_beside_which_the_noise_is_lost_to_rounding_in_most_frames_is_named(value):
    frames = FRAMES.copy()
    frames[1:, 5, 7] = value
    with pytest.raises(tbd.DataError, match=r'frame 1 of a batch at x = 7, y = 5: scale the fr'):
        tbd.detect(frames, threshold=8)


def test_mask_the_wrong_way_round_is_refused():
    with pytest.raises(tbd.DataError, match='mask must be 0 where a pixel holds data'):
        tbd.detect(FRAMES, threshold=8, mask=np.ones((16, 16), bool))


def test_doppler_that_leaves_the_map_at_once_is_refused():
    with pytest.raises(tbd.ParameterError, match='height of a map, 16 bins,.* got 1e.06 bins/s'):
        tbd.detect(FRAMES, threshold=8, motion_model='range_doppler',
                   range_bins_per_doppler_bin=1e6)


def test_absurd_speed_is_cut_to_what_can_be_seen(caplog):
    frames = np.zeros((5, 16, 16))
    frames[:, 8, 8] = 20.0
    assert len(tbd.detect(frames, threshold=12, max_speed_px_s=1e9).trajectories) == 1
    # All that takes an interval or more to cross the frame is searched: nothing is left out.
    assert not caplog.text


def test_search_that_is_too_large_leaves_out_the_fastest_motions_and_says_so(caplog):
    with caplog.at_level(logging.WARNING):
        tbd.detect(np.zeros((3, 200, 200), np.float32), max_speed_px_s=90, threshold=8)
    assert 'speeds up to 90 px/s would be too large' in caplog.text


def test_little_memory_is_kept_to_and_changes_nothing(caplog):
    frames = np.random.default_rng(3).standard_normal((9, 150, 160)).astype(np.float32)
    for t, frame in enumerate(frames):
        add_target(frame, 20 + 1.6 * t, 70 - 0.8 * t, 1.0, 9.0)
        add_target(frame, 140 - 1.1 * t, 90 + 0.3 * t, 1.0, 9.0)
    with caplog.at_level(logging.INFO):
        whole, few = (tbd.detect(frames, max_speed_px_s=3.0, threshold=12, max_memory_gb=memory)
                      for memory in (1.0, 0.1))
    told, told_few = (record.getMessage() for record in caplog.records)
    assert 'searching 9 frames of 160 x 150 pixels takes' in told
    assert 'at once' in told_few and 'at once' not in told
    assert len(whole.trajectories) == 2
    for one, other in zip(whole.trajectories, few.trajectories, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_array_equal(one.amplitudes, other.amplitudes)


def test_memory_that_not_even_what_stands_still_fits_into_is_named():
    with pytest.raises(tbd.ParameterError, match='raise max_memory_gb, 1e-06 now'):
        tbd.detect(FRAMES, threshold=8, max_memory_gb=1e-6)


def test_frames_that_cannot_have_a_noise_of_one_are_named(caplog):
    with caplog.at_level(logging.WARNING):
        tbd.detect(FRAMES, threshold=9)
        assert not caplog.records
        tbd.detect(500 * FRAMES, threshold=9 * 500)
    assert 'spread of 4' in caplog.text and 'noise=robust' in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        tbd.detect(FRAMES + 80, threshold=9 * 500)
    assert 'median of 80' in caplog.text and 'noise=robust' in caplog.text


def test_input_is_left_as_it_was():
    frames = FRAMES.copy()
    frames[0, 0, 0] = np.nan
    before = frames.copy()
    tbd.detect(frames, threshold=6)
    np.testing.assert_array_equal(frames, before)


@pytest.mark.parametrize('dtype', [np.uint8, np.int16, np.uint16, np.float32, np.float64])
def test_every_number_type_is_searched(dtype):
    frames = np.zeros((5, 32, 32), dtype)
    frames[:, 16, 12] = 100
    result = tbd.detect(frames, threshold=50)
    assert len(result.trajectories) == 1
    np.testing.assert_allclose(result.trajectories[0].positions, [[12, 16]] * 5, atol=0.05)


def test_one_frame_and_one_row_are_frames_too():
    frames = np.zeros((1, 1, 40))
    frames[0, 0, 20] = 30.0
    result = tbd.detect(frames, threshold=8)
    np.testing.assert_allclose(result.trajectories[0].positions, [[20, 0]], atol=0.05)


def test_blank_frames_hold_nothing():
    result = tbd.detect(np.zeros((5, 32, 32)), threshold=8)
    assert result.trajectories == [] and result.status == 'converged'


@pytest.mark.parametrize('motion_model', ['constant_velocity', 'static'])
def test_other_motion_models_find_what_moves_their_way(motion_model):
    speed = 0.0 if motion_model == 'static' else 0.5
    recording = simulate('single_target', 3, snr=5.0, speed_px_per_frame=speed)
    result = tbd.detect(recording.frames, recording.stamps, motion_model=motion_model,
                        threshold=9)
    truth = recording.truth[:, 2:]
    assert len(result.trajectories) == 1
    assert np.hypot(*(result.trajectories[0].positions - truth).T).mean() < 1


def test_three_dim_targets_are_found_and_nothing_else():
    # 24 targets at SNR 3; each is found at least 98 % of the time, so two misses are allowed
    # (0.4 % chance of more), and a false alarm has 5 %.
    found = false = 0
    for seed in range(8):
        recording = simulate('three_targets', 1000 + seed)
        # The threshold of these frames at the rate that is asked for unless given.
        result = tbd.detect(recording.frames, recording.stamps, threshold=8.0)
        errors = np.array([[
            np.hypot(*(trajectory.positions - recording.truth[recording.truth[:, 1] == i][:, 2:]).T
                     ).mean() for trajectory in result.trajectories]
            for i in np.unique(recording.truth[:, 1])])
        found += np.sum(errors.min(axis=1) < 1.5)
        false += len(result.trajectories) - np.sum(errors.min(axis=0) < 1.5)
    assert found >= 22
    assert false <= 3


def test_noise_yields_no_more_than_the_requested_false_alarms(calibrate_on):
    # The rate of 200 crops is uncertain by a quarter of itself. 40 batches at 5 %: more than eight
    # has a chance below 0.1 % at a true rate of 7.5 %.
    calibrate_on(200)
    generator = np.random.default_rng(77)
    alarms = sum(bool(tbd.detect(generator.standard_normal((20, 96, 96))).trajectories)
                 for _ in range(40))
    assert alarms <= 8


def test_a_preset_holds_where_nothing_is_told_and_says_why():
    scene = 900 + 100 * np.add.outer(np.sin(np.arange(24)), np.cos(np.arange(32)))
    frames = scene + np.random.default_rng(0).standard_normal((6, 24, 32))
    result = tbd.detect(frames, preset='auto', threshold=1e3)
    assert 'the frames show a scene' in result.remarks[0]
    assert not result.trajectories
    assert not tbd.detect(FRAMES, threshold=8).remarks
    with pytest.raises(tbd.ParameterError, match="unknown preset 'eoir'"):
        tbd.detect(FRAMES, preset='eoir', threshold=8)


def test_frames_of_unit_noise_are_searched_alike_with_and_without_a_look():
    frames = np.random.default_rng(1).standard_normal((8, 24, 32))
    frames[:, 11:13, 15:17] += 6
    plain, looked = (tbd.detect(frames, preset=preset, threshold=8) for preset in ('none', 'auto'))
    assert len(plain.trajectories) == len(looked.trajectories) == 1
    np.testing.assert_array_equal(
        plain.trajectories[0].positions, looked.trajectories[0].positions)
