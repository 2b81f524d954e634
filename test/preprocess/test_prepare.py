"""Frames come out registered, without background and with unit noise."""

import itertools
import os
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.errors import DataError
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.per_frame import KeptFrames
from track_before_detect.preprocess.prepare import noise_of_one, pictures, prepare
from track_before_detect.preprocess.robust import robust_deviation
from track_before_detect.types import FrameBatch

REGISTRATIONS = ('none', 'translation', 'affine', 'homography')
BACKGROUNDS = ('none', 'temporal_median', 'spatial_median', 'temporal_spatial_median')
NOISES = ('none', 'robust', 'map')


def batch_of(frames):
    n_frames = len(frames)
    return FrameBatch(frames, np.arange(n_frames) / 25, np.arange(n_frames) + 100)


def prepared_from(frames, width_px=1.0, **options):
    return prepare(batch_of(frames), DetectorOptions.from_mapping(options), width_px)


def test_nothing_asked_for_passes_the_frames_on():
    frames = np.random.default_rng(0).normal(5, 2, (4, 10, 12))
    prepared = prepared_from(frames)
    np.testing.assert_array_equal(prepared.frames, frames.astype(np.float32))
    assert prepared.frames.dtype == np.float32
    assert prepared.noise_level.shape == (1, 1, 1) and prepared.noise_level.item() == 1
    np.testing.assert_array_equal(prepared.maps, np.tile(np.eye(3), (4, 1, 1)))
    np.testing.assert_array_equal(prepared.frame_indices, np.arange(4) + 100)


@settings(max_examples=24, deadline=None)
@given(st.sampled_from(list(itertools.product(REGISTRATIONS, BACKGROUNDS, NOISES))),
       st.sampled_from(['uint8', 'uint16', '>u2', 'float32', '>f8']), st.integers(3, 6),
       st.integers(0, 99))
def test_every_combination_leaves_its_input_and_keeps_its_shape(steps, dtype, n_frames, seed):
    rng = np.random.default_rng(seed)
    frames = rng.normal(100, 9, (n_frames, 33, 41)).astype(dtype)
    if frames.dtype.kind == 'f':
        frames[rng.random(frames.shape) < 0.02] = rng.choice([np.nan, np.inf, -np.inf])
    before = frames.copy()
    registration, background, noise = steps
    prepared = prepared_from(frames, registration=registration, background=background, noise=noise)
    np.testing.assert_array_equal(frames, before)
    assert prepared.frames.shape == frames.shape
    assert not np.isinf(prepared.frames).any()
    np.broadcast_to(prepared.noise_level, frames.shape)
    assert np.isnan(prepared.frames[~np.isfinite(frames)]).all() or registration != 'none'


@pytest.mark.parametrize('noise', ['robust', 'map'])
def test_frames_times_level_are_in_the_units_of_the_input(noise):
    frames = np.random.default_rng(1).normal(0, 7, (10, 64, 64))
    prepared = prepared_from(frames, noise=noise)
    assert prepared.frames.std() == pytest.approx(1.0, rel=0.02 if noise == 'robust' else 0.1)
    np.testing.assert_allclose(prepared.frames * prepared.noise_level, frames, rtol=1e-4)


def test_noise_has_unit_deviation_after_the_background_is_off():
    rng = np.random.default_rng(2)
    frames = rng.normal(0, 3, (20, 96, 96)) + rng.uniform(0, 500, (96, 96))
    prepared = prepared_from(frames, background='temporal_median', noise='robust')
    assert prepared.frames.std() == pytest.approx(1.0, rel=0.02)


def test_a_target_is_found_back_at_its_original_position():
    rng = np.random.default_rng(3)
    scene = rng.normal(0, 20, (120, 160))
    frames = np.array([scene[20:100, 20 + 2 * t:120 + 2 * t] for t in range(9)])
    frames += rng.normal(size=frames.shape)
    positions = np.array([(30 + t, 40 + 2 * t) for t in range(9)])
    for t, (x, y) in enumerate(positions):
        frames[t, y, x] += 60
    prepared = prepared_from(frames, registration='translation', background='temporal_median',
                             noise='robust')
    np.testing.assert_allclose(prepared.maps[:, 0, 2], 8 - 2 * np.arange(9))
    for t, (x, y) in enumerate(positions):
        row, column = np.unravel_index(np.nanargmax(prepared.frames[t]), frames[t].shape)
        seen = geometry.apply(prepared.maps[t], np.array([column, row]))
        np.testing.assert_allclose(seen, (x, y))


def camera(n_frames, shape):
    """Return the maps of a camera that turns 0.7 degrees and zooms by 1 % each frame."""
    middle = np.array([[1, 0, -0.5 * shape[1]], [0, 1, -0.5 * shape[0]], [0, 0, 1]])
    maps = []
    for t in np.arange(n_frames) - n_frames // 2:
        turn, zoom = np.deg2rad(0.7 * t), 1.01**t
        maps.append(np.linalg.inv(middle) @ np.array([
            [zoom * np.cos(turn), -zoom * np.sin(turn), 0.4 * t],
            [zoom * np.sin(turn), zoom * np.cos(turn), 0], [0, 0, 1]]) @ middle)
    return np.array(maps)


@pytest.mark.parametrize('noise', ['robust', 'map'])
def test_the_scene_seen_by_a_turning_camera_goes_and_the_matched_filter_has_unit_noise(noise):
    rng = np.random.default_rng(7)
    shape = (120, 140)
    maps = camera(11, shape)
    scene = ndimage.gaussian_filter(rng.normal(size=(220, 240)), 2.0)
    scene *= 30 / scene.std()
    y, x = np.mgrid[:shape[0], :shape[1]]
    frames = []
    for back in geometry.inverse(maps):
        at = geometry.apply(back, np.stack([x, y], axis=-1)) + 50
        frames.append(ndimage.map_coordinates(scene, [at[..., 1], at[..., 0]], order=3))
    frames = np.array(frames) + rng.normal(0, 2, (11, *shape))
    prepared = prepared_from(frames, registration='affine', background='temporal_median',
                             noise=noise)
    profile = np.exp(-0.5 * np.arange(-4, 5)**2)
    profile /= np.linalg.norm(profile)
    seen = prepared.frames
    for axis in (1, 2):
        seen = ndimage.convolve1d(seen, profile, axis=axis)
    assert np.nanstd(seen) == pytest.approx(1.0, abs=0.05)
    assert np.nanmedian(prepared.noise_level) == pytest.approx(2.0, rel=0.12)


def test_correlated_noise_is_scaled_at_the_width_of_the_target():
    frames = ndimage.gaussian_filter(np.random.default_rng(6).normal(size=(6, 64, 64)), (0, 1, 1))
    for width_px in (1.0, 2.0):
        profile = np.exp(-0.5 * (np.arange(-8, 9) / width_px)**2)
        seen = prepared_from(frames, width_px, noise='robust').frames
        for axis in (1, 2):
            seen = ndimage.convolve1d(seen, profile / np.linalg.norm(profile), axis=axis)
        assert seen.std() == pytest.approx(1.0, rel=0.1)


def test_quantised_dark_frames_do_not_explode():
    frames = np.full((8, 32, 32), 12, np.uint8)
    frames[3, 10, 10] = 15
    prepared = prepared_from(frames, background='temporal_median', noise='map')
    assert np.nanmax(np.abs(prepared.frames)) <= 3 / 0.3 + 1e-4


def test_a_frame_masked_entirely_stays_masked():
    frames = np.random.default_rng(4).normal(size=(6, 40, 40))
    frames[2] = np.nan
    prepared = prepared_from(frames, registration='translation',
                             background='temporal_spatial_median', noise='robust')
    assert np.isnan(prepared.frames[2]).all()
    assert np.isfinite(prepared.frames[[0, 1, 3, 4, 5]]).mean() > 0.9


def test_complex_noise_gets_unit_power():
    rng = np.random.default_rng(5)
    frames = 4 * (rng.normal(size=(12, 50, 50)) + 1j * rng.normal(size=(12, 50, 50)))
    frames[0, 0, 0] = np.nan
    clutter = 100 * rng.normal(size=(50, 50))
    for noise in ('robust', 'map'):
        prepared = prepared_from(frames + clutter, background='temporal_median', noise=noise,
                                 amplitudes='complex')
        assert prepared.frames.dtype == np.complex64
        assert np.isnan(prepared.frames[0, 0, 0])
        power = np.nanmean(np.abs(prepared.frames) ** 2)
        assert power == pytest.approx(1.0, rel=0.06)


@pytest.mark.parametrize('noise', ['robust', 'map'])
def test_masked_pixels_say_nothing_of_complex_noise(noise):
    rng = np.random.default_rng(8)
    frames = rng.normal(size=(24, 50, 50)) + 1j * rng.normal(size=(24, 50, 50))
    mask = rng.random((50, 50)) < 0.3
    prepared = prepared_from(frames, noise=noise, mask=mask, amplitudes='complex')
    np.testing.assert_array_equal(np.isnan(prepared.frames[0]), mask)
    assert np.nanmean(np.abs(prepared.frames) ** 2) == pytest.approx(1.0, rel=0.06)


@pytest.mark.parametrize(('dtype', 'amplitudes'), [(complex, 'signed'), (float, 'complex')])
def test_frames_of_another_kind_than_the_amplitudes_are_refused(dtype, amplitudes):
    with pytest.raises(DataError, match='complex'):
        prepared_from(np.zeros((3, 9, 9), dtype), amplitudes=amplitudes)


@pytest.mark.parametrize(('frames', 'words'), [
    (np.full((3, 8, 8), np.nan), 'no pixel'),
    (np.zeros((8, 8)), 'shape'),
    (np.zeros((0, 8, 8)), 'shape'),
    (np.zeros((2, 8, 8), bool), 'numbers'),
], ids=['not finite', 'one image', 'no frame', 'truth values'])
def test_frames_that_cannot_be_used_are_refused(frames, words):
    with pytest.raises(DataError, match=words):
        prepared_from(frames)


def test_frames_without_noise_cannot_be_scaled():
    with pytest.raises(DataError, match='noise level'):
        prepared_from(np.full((3, 8, 8), 4.0), noise='robust')


@pytest.mark.parametrize('changes', [{'background': 'temporal_median'}, {'noise': 'map'}],
                         ids=['background', 'noise'])
def test_two_frames_cannot_say_what_stands_still(changes):
    frames = np.random.default_rng(0).normal(size=(2, 8, 8))
    with pytest.raises(DataError, match='at least 3 frames, got 2'):
        prepared_from(frames, **changes)


def test_one_frame_can_be_prepared_in_space():
    frames = np.random.default_rng(0).normal(size=(1, 64, 64))
    prepared = prepared_from(frames, registration='translation', background='spatial_median',
                             noise='robust')
    assert prepared.frames.std() == pytest.approx(1.0, rel=0.05)


def test_too_few_stamps_are_refused():
    with pytest.raises(DataError, match='stamps'):
        prepare(FrameBatch(np.zeros((3, 8, 8)), np.arange(2.0), np.arange(3)), DetectorOptions(),
                1.0)


def test_the_real_drone_is_the_brightest_thing_after_preparation():
    folder = os.environ.get('TBD_DATA_DIR')
    if not folder or not (Path(folder) / 'ir_antiuav5_sky.npz').is_file():
        pytest.skip('needs ir_antiuav5_sky.npz in the folder named by TBD_DATA_DIR')
    with np.load(Path(folder) / 'ir_antiuav5_sky.npz') as archive:
        frames, truth = archive['frames'][100:120], archive['truth'][100:120, 2:]
    prepared = prepared_from(frames, registration='translation',
                             background='temporal_spatial_median', noise='robust')
    for t in range(20):
        row, column = np.unravel_index(np.nanargmax(prepared.frames[t]), frames[t].shape)
        seen = geometry.apply(prepared.maps[t], np.array([column, row]))
        assert np.hypot(*(seen - truth[t])) < 3.0


def panned_scene(n_frames=8, step=2.0):
    """Return a still texture seen by a camera that moves by ``step`` px a frame along x."""
    rng = np.random.default_rng(12)
    ground = 40 * ndimage.gaussian_filter(rng.normal(size=(60, 120)), 1.5)
    frames = np.array([ground[:, int(step * k):int(step * k) + 70] for k in range(n_frames)])
    return frames + rng.normal(size=frames.shape)


def test_search_on_the_image_leaves_targets_at_the_pixels_of_their_frames():
    frames = panned_scene()
    # It stays on a pixel of the image, as seen by a camera that follows it.
    frames[:, 30, 40] += 60
    options = {'registration': 'translation', 'background': 'temporal_median', 'noise': 'robust'}
    image = prepared_from(frames, search_plane='image', **options)
    assert image.maps.shape == (8, 3, 3)
    np.testing.assert_array_equal(image.maps, np.tile(np.eye(3), (8, 1, 1)))
    for frame in image.frames:
        assert np.unravel_index(np.nanargmax(frame), frame.shape) == (30, 40)
    # The ground is gone: taken off through the registration.
    assert np.nanstd(image.frames[:, 5:25, 20:50]) < 1.3
    scene = prepared_from(frames, search_plane='scene', **options)
    columns = [np.nanargmax(frame[30]) for frame in scene.frames]
    assert np.ptp(columns) == pytest.approx(14, abs=1)


def test_search_on_the_image_needs_no_registration_for_a_spatial_background(caplog):
    rng = np.random.default_rng(13)
    # A slope would leave more than noise at the border.
    frames = rng.normal(500, 1, (5, 40, 40))
    # Noise has no shift that registration could find, and would say so.
    prepared = prepared_from(frames, search_plane='image', registration='translation',
                             background='spatial_median', noise='local')
    assert not caplog.records
    np.testing.assert_array_equal(prepared.maps, np.tile(np.eye(3), (5, 1, 1)))
    assert np.nanstd(prepared.frames) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize('sigma', [0.0, 1.0, 10.0])
def test_leftovers_that_last_add_up_to_no_more_than_noise(sigma):
    rng = np.random.default_rng(12)
    scene = 5 * rng.standard_normal((60, 90))
    scene[:, :45] /= 10
    frames = (100 + scene + sigma * rng.standard_normal((16, 60, 90))).astype(np.float32)
    left = prepared_from(frames, background='spatial_median', noise='local').frames
    together = left.sum(axis=0)[8:-8] / 4
    assert together[:, 58:-8].std() < 1.25 * together[:, 8:32].std()
    assert robust_deviation(left) == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize('noise', ['local', 'robust'])
def test_overlapping_batches_are_prepared_in_two_stages_as_each_is_alone(noise):
    rng = np.random.default_rng(7)
    ground = ndimage.gaussian_filter(rng.normal(size=(60, 110)), 2) * 400 + 1000
    recording = np.array([ground[:, t:t + 80] + rng.normal(size=(60, 80)) for t in range(24)])
    recording[10] = 0
    recording = np.rint(recording).astype(np.uint16)
    options = DetectorOptions.from_mapping({
        'bad_frames': 'find', 'bad_pixels': 'find', 'registration': 'translation',
        'search_plane': 'image', 'noise': noise})
    kept = KeptFrames(8)
    for first in (0, 8):
        at = np.arange(first, first + 16)
        batch = FrameBatch(recording[at], at.astype(float), at)
        seen = pictures(batch, options, 1.5, kept)
        before = seen.frames.copy()
        for background in ('spatial_median', 'temporal_median'):
            chosen = options.replace(background=background)
            found = noise_of_one(seen, batch, chosen, 1.5, kept)
            alone = prepare(batch, chosen, 1.5)
            assert np.isnan(found.frames[10 - first]).all()
            np.testing.assert_array_equal(found.frames, alone.frames)
            np.testing.assert_array_equal(found.noise_level, alone.noise_level)
            np.testing.assert_array_equal(found.scene, alone.scene)
            assert found.remarks == alone.remarks
        np.testing.assert_array_equal(seen.frames, before)
