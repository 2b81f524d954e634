"""Frames without a picture of the scene are told from scenes that move, darken or drift."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.preprocess.faults.frame_faults import (
    at_an_end,
    frame_faults,
    other_scenes,
)

T, SHAPE = 20, (64, 80)


def texture(rng, sigma_px=2.0, deviation=30.0, margin=0):
    size = (SHAPE[0] + 2 * margin, SHAPE[1] + 2 * margin)
    image = ndimage.gaussian_filter(rng.standard_normal(size), sigma_px)
    return image * deviation / image.std()


def still(seed, deviation=30.0):
    """Return frames of a still scene with noise of 4, and the generator they came from."""
    rng = np.random.default_rng(seed)
    scene = 500 + texture(rng, deviation=deviation)
    return (scene + 4 * rng.standard_normal((T, *SHAPE))).astype(np.float32), rng


def found(frames):
    return {kind: np.flatnonzero(which).tolist()
            for kind, which in frame_faults(frames).items() if which.any()}


def blank(frames, rng):
    frames[7:9] = 0


def covered(frames, rng):
    frames[7:9] = 200 + 2 * rng.standard_normal((2, *SHAPE))


def saturated(frames, rng):
    frames[7:9] = np.where(rng.random((2, *SHAPE)) < 0.8, 4095, frames[7:9])


def garbage(frames, rng):
    frames[7:9] = rng.uniform(0, 4095, (2, *SHAPE))


@pytest.mark.parametrize(('spoil', 'kind', 'deviation'), [
    (blank, 'blank', 0.0), (saturated, 'saturated', 0.0), (garbage, 'garbage', 0.0),
    (blank, 'blank', 30.0), (saturated, 'saturated', 30.0), (garbage, 'garbage', 30.0),
    (covered, 'blank', 30.0)])
def test_a_frame_that_is_no_picture_is_found(spoil, kind, deviation):
    frames, rng = still(1, deviation)
    spoil(frames, rng)
    assert found(frames) == {kind: [7, 8]}


def stronger(frames, rng):
    frames[9:] = 300 + 1.5 * frames[9:]


def much_stronger(frames, rng):
    frames[17:] *= 8


def fading(frames, rng):
    frames *= np.linspace(1, 0.4, T)[:, None, None]


def with_a_target(frames, rng):
    for t in range(T):
        frames[t, 30:36, 2 * t:2 * t + 6] += 4000


@pytest.mark.parametrize('change', [stronger, much_stronger, fading, with_a_target])
def test_another_gain_or_content_is_no_fault(change):
    frames, rng = still(2)
    change(frames, rng)
    assert found(frames) == {}
    odd = other_scenes(frames)
    assert odd is not None and not odd.any()


@pytest.mark.parametrize('value', [0.0, 7.0])
def test_frames_of_one_value_are_blank(value):
    assert found(np.full((T, *SHAPE), value, np.float32)) == {'blank': list(range(T))}


def test_nothing_is_found_in_noise():
    for seed in range(20):
        frames = np.random.default_rng(seed).standard_normal((T, *SHAPE)).astype(np.float32)
        assert found(frames) == {}
        odd = other_scenes(frames)
        assert odd is None or not odd.any()


@pytest.mark.parametrize('cut', [3, 9, 10, 16])
def test_the_smaller_side_of_a_cut_is_another_scene(cut):
    for seed in range(5):
        frames, rng = still(seed)
        frames[cut:] += (texture(rng) + 100 - texture(np.random.default_rng(seed))).astype('f4')
        odd = other_scenes(frames)
        expected = np.arange(T) < cut if cut < T / 2 or cut == 10 else np.arange(T) >= cut
        np.testing.assert_array_equal(odd, expected)
        np.testing.assert_array_equal(at_an_end(odd), expected)


def test_a_frame_of_another_scene_is_odd_and_not_after_a_cut():
    frames, rng = still(4)
    frames[6] = 500 + texture(rng)
    odd = other_scenes(frames)
    assert np.flatnonzero(odd).tolist() == [6]
    assert not at_an_end(odd).any()


@pytest.mark.parametrize('speed', [0.5, 2.0, 7.0])
def test_a_pan_is_no_cut(speed):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        scene = texture(rng, margin=80)
        frames = np.stack([ndimage.shift(scene, (0, -speed * (t - 10)), order=1)[80:-80, 80:-80]
                           for t in range(T)])
        odd = other_scenes((frames + rng.standard_normal(frames.shape)).astype(np.float32))
        assert odd is None or not odd.any()


def test_frames_that_repeat_say_nothing_of_the_others():
    frames = np.random.default_rng(5).standard_normal((T, *SHAPE)).astype(np.float32)
    frames[5:16] = frames[4]
    odd = other_scenes(frames)
    assert odd is None or not odd.any()


def test_masked_frames_are_passed_over():
    frames, rng = still(6)
    frames[8:11] = np.nan
    frames[14:] = 500 + texture(rng) + 4 * rng.standard_normal((6, *SHAPE))
    assert found(frames) == {}
    assert np.flatnonzero(other_scenes(frames)).tolist() == list(range(14, 20))
    assert found(np.full_like(frames, np.nan)) == {}
    assert other_scenes(np.full_like(frames, np.nan)) is None
