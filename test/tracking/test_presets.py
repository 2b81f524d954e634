"""A look at the first frames chooses options; what was told stays."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.capabilities import check_options
from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.presets import (
    AUTO,
    choose_for,
    choose_for_sensors,
    choose_options,
    NONE,
    PRESETS,
)

NO_FRAMES = np.zeros((0, 4, 4))


def unit_noise(seed, shape=(20, 48, 64), n_targets=0):
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal(shape)
    n_frames, height, width = shape
    y, x = np.mgrid[:height, :width]
    for _ in range(n_targets):
        start, step = rng.uniform(0, [width, height]), rng.uniform(-1, 1, 2)
        snr = np.exp(rng.uniform(np.log(3), np.log(50)))
        for k, frame in enumerate(frames):
            cx, cy = start + k * step
            spot = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2)
            frame += snr * spot / max(np.linalg.norm(spot), 1e-9)
    return frames


def scene(shape=(10, 64, 80), jitter=0.0, seed=3):
    rng = np.random.default_rng(seed)
    n_frames, height, width = shape
    ground = 30 * ndimage.gaussian_filter(rng.normal(size=(height + 40, width + 40)), 1.5) / 0.19
    y, x = np.mgrid[:height, :width]
    moves = np.cumsum(rng.normal(0, jitter, (n_frames, 2)), axis=0)
    frames = [ndimage.map_coordinates(ground, [y + 20 + dy, x + 20 + dx]) for dx, dy in moves]
    return np.array(frames) + 500 + 2 * rng.normal(size=shape)


@pytest.mark.parametrize('n_targets', [0, 1, 3, 6])
@pytest.mark.parametrize('shape', [(20, 64, 64), (20, 40, 160), (5, 128, 128), (2, 256, 256)])
def test_simulated_noise_is_searched_as_before(shape, n_targets):
    for seed in range(8):
        choice = choose_options(AUTO, {}, unit_noise([seed, n_targets], shape, n_targets))
        assert choice.options == DetectorOptions()
        assert len(choice.reasons) == 1


@pytest.mark.parametrize('frames', [
    10 + unit_noise(1), 2 * unit_noise(1),
    ndimage.gaussian_filter(unit_noise(1), (0, 1, 1)) / 0.28,
    unit_noise(1)[:1].repeat(20, axis=0), np.abs(unit_noise(1))])
def test_other_noise_is_not_taken_for_the_simulated_one(frames):
    options, reasons = choose_options(AUTO, {}, frames)
    assert options.calibration == 'clutter'
    assert 'scene' in reasons[0]


def test_complex_frames_are_scaled_and_nothing_else():
    frames = unit_noise(1) + 1j * unit_noise(2)
    options, [reason] = choose_options(AUTO, {}, frames)
    assert options == DetectorOptions(amplitudes='complex', noise='robust')
    assert 'complex' in reason


def test_shaking_scene_is_registered_and_searched_on_the_image():
    options, reasons = choose_options(AUTO, {}, scene(jitter=1.0))
    assert options.registration == 'auto'
    assert options.search_plane == 'image'
    assert any('px' in reason for reason in reasons)


@pytest.mark.parametrize(('noise', 'width'), [(0.0, 1.5), (30.0, 1.0)])
def test_targets_are_sharp_where_white_noise_is_what_hides_them(noise, width):
    frames = scene(jitter=1.0)
    frames += noise * np.random.default_rng(6).normal(size=frames.shape)
    options, reasons = choose_options(AUTO, {}, frames)
    assert options.psf_sigma_px == width
    assert any('psf_sigma_px=1' in reason for reason in reasons) == (width == 1.0)


@pytest.mark.parametrize('value', [0, np.nan, 7])
@pytest.mark.parametrize('shape', [(20, 16, 16), (2, 8, 8), (1, 1, 50)])
def test_blank_frames_are_no_error(value, shape):
    frames = np.full(shape, value, float)
    options, reasons = choose_options(AUTO, {}, frames)
    check_options(options)
    assert reasons


@pytest.mark.parametrize('n_blank', [5, 20, 60])
def test_a_recording_that_begins_without_data_is_chosen_for_by_what_follows(n_blank):
    frames = np.concatenate([np.full((n_blank, 64, 80), np.nan), scene(jitter=1.0)])
    assert choose_for(frames, AUTO, {}) == choose_options(AUTO, {}, frames[n_blank:])


def test_frames_without_data_are_not_said_to_be_noise():
    blank = np.full((30, 8, 8), np.nan)
    options, [reason] = choose_for(blank, AUTO, {})
    assert options == DetectorOptions() and 'no pixel' in reason and 'noise' not in reason
    options, reasons = choose_for_sensors({}, {'left': blank, 'right': blank})
    assert options == DetectorOptions()
    assert reasons == [f'sensor {name} has sent no finite pixel yet' for name in ('left', 'right')]


def test_masked_pixels_do_not_matter():
    frames = unit_noise(4)
    frames[:, :5] = np.nan
    frames[3] = np.nan
    frames[:, 20, 20] = np.inf
    assert choose_options(AUTO, {}, frames).options == DetectorOptions()


@pytest.mark.parametrize('name', [field.name for field in dataclasses.fields(DetectorOptions)])
def test_an_option_told_at_its_default_stays_there(name):
    default = getattr(DetectorOptions(), name)
    for preset, frames in [(AUTO, scene(jitter=1.0)), *((name, NO_FRAMES) for name in PRESETS)]:
        assert getattr(choose_options(preset, {name: default}, frames).options, name) == default


@pytest.mark.parametrize('told', [
    {'noise': 'map'}, {'background': 'none'}, {'psf_sigma_px': 3.0}, {'batch_length': 20},
    {'batch_length': 8}, {'hop': 2}, {'false_alarm_rate': 0.2}, {'amplitudes': 'non-negative'},
    {'search_plane': 'scene'}, {'registration': 'homography'}, {'calibration': 'noise'},
    {'threshold': 9.0}, {'detector': 'greedy'}, {'presence': 'partial'},
    {'amplitude_model': 'constant'}, {'motion_model': 'static'}, {'max_speed_px_s': 30.0}])
def test_what_was_told_wins_and_goes_with_the_rest(told):
    options, _ = choose_options(AUTO, told, scene(jitter=1.0))
    assert {name: getattr(options, name) for name in told} == told
    check_options(options)


def test_threshold_from_noise_is_said_to_be_passed_by_scenes():
    options, reasons = choose_options(AUTO, {'threshold': 9.0}, scene())
    assert options.calibration == 'noise'
    assert 'threshold from noise' in reasons[-1]


@pytest.mark.parametrize('preset', PRESETS)
def test_every_preset_is_valid(preset):
    told = {'range_bins_per_doppler_bin': 0.1} if preset == 'radar_range_doppler' else {}
    options, _ = choose_options(preset, told, NO_FRAMES)
    check_options(options)
    assert (options == DetectorOptions()) == (preset == NONE)


def test_unknown_names_are_refused_with_the_nearest():
    with pytest.raises(ParameterError, match='eoir_static'):
        choose_options('eoir_statik', {}, NO_FRAMES)
    with pytest.raises(ParameterError, match='background'):
        choose_options(AUTO, {'backgroud': 'none'}, unit_noise(1))


@pytest.mark.parametrize('kind', [np.uint8, np.uint16, np.int16, np.int64, np.float64])
def test_whole_numbers_and_doubles_of_any_size_are_looked_at(kind):
    scene = 120 + 20 * np.random.default_rng(0).standard_normal((6, 24, 32))
    options, _ = choose_options('auto', {}, scene.astype(kind))
    assert options.background == 'either'


@pytest.mark.parametrize('value', [1e38, -3e38])
def test_a_frame_of_garbage_changes_no_choice(value, recwarn):
    scene = 1000 + 50 * np.random.default_rng(0).standard_normal((12, 24, 32)).astype(np.float32)
    spoilt = np.insert(scene, 5, value, axis=0)
    assert choose_options('auto', {}, spoilt) == choose_options('auto', {}, scene)
    assert not recwarn


def test_several_sensors_of_unit_noise_are_taken_as_they_are():
    options, [reason] = choose_for_sensors({}, {'a': unit_noise(1), 'b': unit_noise(2)})
    assert options == DetectorOptions() and 'all sensors are white noise' in reason


def test_a_scene_of_one_of_several_sensors_is_taken_off_where_all_can_honour_it():
    still = {'a': unit_noise(1), 'b': scene(seed=4), 'c': np.empty((0, 8, 8))}
    options, reasons = choose_for_sensors({}, still)
    check_options(options, several_sensors=True)
    assert (options.background, options.noise, options.batch_length) == (
        'temporal_median', 'robust', 30)
    assert reasons[0] == 'sensor c has sent no finite pixel yet'
    assert 'frames of b show' in reasons[1]
    options, reasons = choose_for_sensors({'noise': 'map'}, {**still, 'd': scene(jitter=1.0)})
    check_options(options, several_sensors=True)
    assert (options.background, options.noise) == ('spatial_median', 'map')
    few = choose_for_sensors({}, {'a': unit_noise(1), 'b': scene(seed=4)[:2]})
    assert few.options.background == 'spatial_median'
    assert 'pictures move (d by ' in reasons[-1]


def test_the_psf_of_several_sensors_is_sharp_where_the_noise_of_each_is_white():
    noisy = {name: 100 + 20 * unit_noise(seed) for seed, name in enumerate('ab')}
    assert choose_for_sensors({}, noisy).options.psf_sigma_px == 1.0
    smooth = ndimage.gaussian_filter(noisy['b'], (0, 1, 1))
    assert choose_for_sensors({}, {**noisy, 'b': smooth}).options.psf_sigma_px == 1.5


def test_complex_frames_of_several_sensors_are_searched_as_such():
    options, _ = choose_for_sensors({}, {'a': 3j * unit_noise(1)})
    assert (options.amplitudes, options.noise) == ('complex', 'robust')
