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


def symbols(frames, value):
    """Draw a cross-hair, a frame and a few characters."""
    drawn = np.zeros(frames.shape[1:], bool)
    drawn[24, 10:20] = drawn[24, 26:36] = drawn[14:20, 22] = True
    drawn[4:11, 50:54] = True
    drawn[5:10, 51:53] = False
    for x in range(4, 20, 4):
        drawn[40:44, x] = drawn[41, x + 1] = True
    frames[:, drawn] = value
    return drawn


@pytest.mark.parametrize('value', [0.0, 255.0])
def test_symbols_at_an_end_of_the_range_are_masked(value):
    frames = np.rint(noise(3, level=120.0, deviation=4.0)).astype(np.float32)
    drawn = symbols(frames, value)
    found = bad_pixels(frames)
    np.testing.assert_array_equal(found.mask, np.broadcast_to(drawn, frames.shape))
    assert any('burnt-in' in sentence for sentence in found.remarks.values())


def test_a_dark_sky_at_the_end_of_the_range_is_no_symbol():
    frames = np.rint(noise(4, level=40.0, deviation=3.0))
    sky = np.zeros(frames.shape[1:])
    sky[8:30, 10:50] = 60
    frames = np.maximum(frames - sky, 0).astype(np.float32)
    frames[:, 30:34] = np.maximum(frames[:, 30:34] - 37, 0)
    assert (frames[:, 15:25, 20:40] == 0).all()
    assert not bad_pixels(frames).mask[:, 8:30, 10:50].any()


def spot_at(x, y, sigma, size=(48, 64)):
    rows, columns = np.mgrid[:size[0], :size[1]]
    return np.exp(-((columns - x)**2 + (rows - y)**2) / (2 * sigma**2))


@pytest.mark.parametrize('sigma', [0.6, 1.0, 2.0])
@pytest.mark.parametrize('peak', [300.0, 2000.0])
def test_a_saturated_target_that_hovers_is_kept(sigma, peak):
    frames = noise(5, level=100.0, deviation=3.0) + peak * spot_at(30.3, 20.2, sigma)
    frames = np.clip(np.rint(frames), 0, 255).astype(np.float32)
    assert (frames[:, 20, 30] == 255).all()
    assert not bad_pixels(frames, sigma).mask.any()


def test_saturated_areas_are_masked_with_their_border_wherever_they_are():
    frames = noise(6, level=100.0, deviation=3.0)
    expected = np.zeros(frames.shape, bool)
    for t in range(len(frames)):
        frames[t, 10:24, 5 + t:30 + t] = 400
        expected[t, 10:24, 5 + t:30 + t] = True
    frames += 400 * spot_at(50, 40, 1.0)
    found = bad_pixels(np.clip(np.rint(frames), 0, 255).astype(np.float32))
    assert found.mask[expected].all()
    assert not found.mask[:, 35:].any() and not found.mask[:, :7].any()
    assert found.mask[3, 8:26, 6:35].all()
    assert list(found.remarks) == ['saturated']


def test_flat_areas_below_saturation_are_a_picture():
    frames = np.rint(noise(7, level=100.0, deviation=0.4))
    frames[:, 10:30, 10:40] += 20
    assert not bad_pixels(frames.astype(np.float32)).mask.any()


def test_masked_frames_do_not_hide_what_is_wrong_in_the_others():
    frames = noise(8)
    frames[:, 10, 20] += 900
    frames[4:7] = np.nan
    assert np.argwhere(bad_pixels(frames).mask.all(axis=0)).tolist() == [[10, 20]]
