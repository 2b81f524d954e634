"""Pixels that hold no picture are told from sharp scenes and from targets."""

import numpy as np
import pytest

from track_before_detect.preprocess.faults.bad_pixels import bad_pixels


def noise(seed=1, shape=(20, 48, 64), level=8000.0, deviation=25.0):
    return level + deviation * np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.parametrize(('where', 'words'), [
    (np.s_[:, -2:], 'rows 46 to 47 are masked'), (np.s_[:, :1], 'row 0 is masked'),
    (np.s_[:, :, 61:], 'columns 61 to 63 are masked')])
def test_lines_of_telemetry_are_masked_and_named(where, words):
    frames = noise()
    frames[where] = 0
    frames[where][..., 3:5] = 20_000
    found = bad_pixels(frames)
    expected = np.zeros((20, 48, 64), bool)
    expected[where] = True
    np.testing.assert_array_equal(found.mask, expected)
    assert [words in remark for remark in found.remarks.values()] == [True]


def test_hot_and_dead_pixels_are_masked():
    frames = noise()
    frames[:, 10, 20] += 900
    frames[:, 30, 40] = 8000
    found = bad_pixels(frames)
    assert np.argwhere(found.mask.all(axis=0)).tolist() == [[10, 20], [30, 40]]
    assert found.mask.sum() == 2 * len(frames)
    assert found.remarks['hot'] == '1 hot pixel is masked, the first at x = 20, y = 10'
    assert found.remarks['dead'] == '1 dead pixel is masked, the first at x = 40, y = 30'


def test_noise_is_all_picture():
    for seed in range(20):
        assert not bad_pixels(noise(seed)).mask.any()


def test_a_target_that_stands_still_is_no_hot_pixel():
    y, x = np.mgrid[:48, :64]
    for sigma in (0.6, 1.0, 2.0):
        for offset in (0.0, 0.25, 0.5):
            spot = np.exp(-((x - 30 - offset)**2 + (y - 20)**2) / (2 * sigma**2))
            assert not bad_pixels(noise() + 2000 * spot).mask.any()


def test_a_steep_scene_at_the_border_is_a_picture():
    frames = noise()
    frames += 300 * np.arange(48)[:, None]
    assert not bad_pixels(frames).mask.any()


def test_frames_that_never_change_tell_nothing():
    assert not bad_pixels(np.zeros((5, 9, 9))).mask.any()
