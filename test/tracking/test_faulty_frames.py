"""Frames and pixels without a picture are named, and never a burst of trajectories."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect import detect
from track_before_detect.errors import DataError

T, SIZE = 40, 64


def scene(rng):
    image = ndimage.gaussian_filter(rng.standard_normal((SIZE + 40, SIZE + 40)), 2.5)
    return 60 * image / image.std()


def recording(spoil, with_target, is_shaken=False, seed=1):
    """Return 16-bit frames of a scene with noise of 4, and where the target is, (T, 2)."""
    rng = np.random.default_rng(seed)
    shakes = np.cumsum(rng.normal(0, 0.5, (T, 2)), axis=0) * is_shaken
    pictures = []
    for ground in (scene(rng), scene(rng)):
        pictures.append(1000 + np.stack([
            ndimage.shift(ground, -shake, order=3)[20:-20, 20:-20] for shake in shakes]))
    truth = np.stack([16 + 0.7 * np.arange(T), 46 - 0.5 * np.arange(T)], axis=1) - shakes[:, ::-1]
    y, x = np.mgrid[:SIZE, :SIZE]
    for t, (at_x, at_y) in enumerate(truth if with_target else []):
        for picture in pictures:
            picture[t] += 14 * np.exp(-((x - at_x)**2 + (y - at_y)**2) / 2)
    frames, other = (picture + 4 * rng.standard_normal(picture.shape) for picture in pictures)
    spoil(frames, other, rng)
    return np.rint(frames).clip(0, 65535).astype(np.uint16), truth


def nothing(frames, other, rng):
    pass


def blank(frames, other, rng):
    frames[12:15] = np.array([0, 40, 60])[:, None, None]


def covered(frames, other, rng):
    frames[9:12] = 300 + 4 * rng.standard_normal((3, SIZE, SIZE))


def saturated(frames, other, rng):
    frames[22:24] = np.where(rng.random((2, SIZE, SIZE)) < 0.9, 65535, frames[22:24])


def garbage(frames, other, rng):
    frames[17] = rng.uniform(0, 65535, (SIZE, SIZE))


def wrong(frames, other, rng):
    frames[26] = other[26]


def cut(frames, other, rng):
    frames[24:] = other[24:]


def gain(frames, other, rng):
    frames[25:] = 300 + 1.5 * frames[25:]


def flat_field(frames, other, rng):
    frames[13:] += 400


KINDS = [(nothing, None), (blank, 'frames 12 to 14 masked: blank'),
         (covered, 'frames 9 to 11 masked: blank'),
         (saturated, 'frames 22 to 23 masked: saturated'), (garbage, 'frame 17 masked: garbage'),
         (wrong, 'frame 26 masked: unlike the frames around'),
         (cut, 'another scene from frame 24 on'), (gain, None), (flat_field, None)]


def found(frames, **options):
    return detect(frames, threshold=12.0, background='temporal_median', noise='robust',
                  batch_length=20, **options)


@pytest.mark.parametrize(('spoil', 'words'), KINDS)
@pytest.mark.parametrize('is_shaken', [False, True])
def test_a_target_is_followed_through_what_is_no_picture(spoil, words, is_shaken):
    options = {'bad_frames': 'find',
               'registration': 'translation' if is_shaken else 'none'}
    frames, truth = recording(spoil, True, is_shaken)
    result = found(frames, **options)
    assert [words in remark for remark in result.remarks] == ([True] if words else [])
    assert len(result.trajectories) in (1, 2)
    errors = [np.hypot(*(one.positions - truth).T) for one in result.trajectories]
    assert max(np.mean(error < 2) for error in errors) >= 0.9
    empty = found(recording(spoil, False, is_shaken)[0], **options)
    assert len(empty.trajectories) <= 1
    assert empty.remarks == result.remarks


def test_frames_not_asked_about_are_searched_as_they_are():
    frames, _ = recording(garbage, False)
    assert found(frames).remarks == []


def test_the_scene_after_a_cut_is_not_where_trajectories_of_before_go_on():
    frames, truth = recording(cut, True)
    frames = frames[10:30]
    result = found(frames, bad_frames='find')
    [one] = result.trajectories
    assert np.isfinite(one.positions[:14]).all()
    assert np.isnan(one.positions[14:]).all() and np.isnan(one.amplitudes[14:]).all()


def test_a_recording_that_begins_blank_is_searched_from_its_first_picture_on():
    frames, truth = recording(nothing, True)
    dark = np.arange(25, dtype=np.uint16)[:, None, None] % 2 * np.ones_like(frames[:25])
    result = found(np.concatenate([dark, frames]), bad_frames='find')
    assert result.remarks[0].startswith('frames 0 to 19 masked: blank')
    [one] = result.trajectories
    assert np.mean(np.hypot(*(one.positions[25:] - truth).T) < 2) > 0.9


def test_a_failed_registration_is_said_once():
    rng = np.random.default_rng(2)
    noise = 1000 + 4 * rng.standard_normal((T, SIZE, SIZE))
    result = found(noise, registration='translation')
    [remark] = result.remarks
    assert remark.startswith('registration found no shift in most frames')
    assert not result.trajectories


def test_frames_that_cannot_be_registered_are_masked():
    frames, _ = recording(wrong, False, is_shaken=True)
    result = found(frames, registration='translation')
    assert result.remarks == ['frame 26 masked: unlike the frames around']


def test_telemetry_symbols_and_hot_pixels_leave_no_trajectory():
    frames, truth = recording(nothing, True)
    rng = np.random.default_rng(3)
    frames[:, -2:] = rng.integers(0, 65536, (T, 2, SIZE))
    frames[:, 10, 30:34] = 65535
    frames[:, 50, 50] += 5000
    result = found(frames, bad_pixels='find')
    assert sorted(remark.split(' masked')[0] for remark in result.remarks) == [
        '1 hot pixel is', '4 burnt-in pixels are', 'rows 62 to 63 are']
    [one] = result.trajectories
    assert np.mean(np.hypot(*(one.positions - truth).T) < 2) > 0.9


@pytest.mark.parametrize('scale', ['magnitude', 'power', 'decibels'])
def test_a_target_is_found_in_maps_of_every_scale_and_nothing_else(scale):
    rng = np.random.default_rng(4)
    z = (rng.standard_normal((T, SIZE, SIZE)) + 1j * rng.standard_normal((T, SIZE, SIZE))) / 2**0.5
    y, x = np.mgrid[:SIZE, :SIZE]
    truth = np.stack([12 + 0.5 * np.arange(T), 40 - 0.3 * np.arange(T)], axis=1)
    targets = np.stack([2.8 * np.exp(-((x - at_x)**2 + (y - at_y)**2) / 2
                                     + 2j * np.pi * rng.random()) for at_x, at_y in truth])
    scaled = {'magnitude': np.abs, 'power': lambda z: np.abs(z)**2,
              'decibels': lambda z: 20 * np.log10(np.abs(z))}[scale]
    told, recognised = (found(scaled(z + targets), frame_scale=name) for name in (scale, 'auto'))
    [one] = told.trajectories
    assert np.mean(np.hypot(*(one.positions - truth).T) < 2) > 0.9
    np.testing.assert_array_equal(recognised.trajectories[0].positions, one.positions)
    assert told.remarks == []
    assert len(recognised.remarks) == 1 and f'scale {scale}' in recognised.remarks[0]
    assert not found(scaled(z), frame_scale='auto').trajectories


def test_maps_below_zero_are_no_powers():
    frames = np.random.default_rng(5).standard_normal((5, 16, 16))
    with pytest.raises(DataError, match='frame_scale=power needs pixels of at least 0, got -'):
        detect(frames, frame_scale='power', threshold=12.0)
