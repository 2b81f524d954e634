"""Shifts of the scene are found, and images are moved by them."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.preprocess.registration import (
    register_translation,
    shift_fraction,
    shift_whole,
)

SHAPE = (128, 160)


def panned(seed, n_frames=9, noise=0.5, pan=3.0, texture=10.0):
    """Return frames of a rough scene under a panning camera, and its offsets."""
    rng = np.random.default_rng(seed)
    margin = 60
    scene = ndimage.gaussian_filter(
        rng.normal(size=(SHAPE[0] + 2 * margin, SHAPE[1] + 2 * margin)), 2.0, mode='wrap')
    spectrum = np.fft.fft2(scene * texture / scene.std())
    fy, fx = (np.fft.fftfreq(size) for size in scene.shape)
    step = rng.uniform(-pan, pan, 2)
    offsets = np.cumsum(step + rng.normal(0, 0.4, (n_frames, 2)), axis=0)
    offsets -= offsets[n_frames // 2]
    frames = []
    for x, y in offsets:
        phase = np.exp(-2j * np.pi * (fy[:, None] * y + fx * x))
        moved = np.fft.ifft2(spectrum * phase).real
        frames.append(moved[margin:margin + SHAPE[0], margin:margin + SHAPE[1]])
    frames = np.array(frames) + rng.normal(0, noise, (n_frames, *SHAPE))
    return frames.astype(np.float32), offsets


def mover(n_frames, amplitude):
    """Return frames with one target moving 6 px right and 4 px down each frame."""
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    return np.array([
        amplitude * np.exp(-0.5 * ((x - 40 - 6 * t) ** 2 + (y - 40 - 4 * t) ** 2) / 1.5 ** 2)
        for t in range(n_frames)], dtype=np.float32)


@pytest.mark.parametrize('seed', range(4))
def test_offsets_of_a_panned_scene_are_found_below_a_tenth_of_a_pixel(seed):
    frames, offsets = panned(seed)
    found = register_translation(frames)
    np.testing.assert_allclose(found.offsets, offsets, atol=0.1)
    assert found.credible.all()


@pytest.mark.parametrize('seed', range(3))
def test_a_bright_mover_does_not_decide(seed):
    frames, offsets = panned(seed)
    found = register_translation(frames + mover(len(frames), 300.0))
    np.testing.assert_allclose(found.offsets, offsets, atol=0.1)


@pytest.mark.parametrize('seed', range(3))
def test_hot_pixels_do_not_decide(seed):
    frames, offsets = panned(seed)
    rng = np.random.default_rng(100 + seed)
    frames[:, rng.integers(0, SHAPE[0], 40), rng.integers(0, SHAPE[1], 40)] = 500.0
    np.testing.assert_allclose(register_translation(frames).offsets, offsets, atol=0.2)


def test_masked_pixels_are_left_out():
    frames, offsets = panned(1)
    frames[:, 30:60, 20:70] = np.nan
    np.testing.assert_allclose(register_translation(frames).offsets, offsets, atol=0.15)


@pytest.mark.parametrize('amplitude', [0.0, 10.0, 300.0])
def test_frames_of_noise_stand_still_whatever_moves_through_them(amplitude):
    rng = np.random.default_rng(3)
    frames = rng.normal(size=(9, *SHAPE)).astype(np.float32) + mover(9, amplitude)
    found = register_translation(frames)
    assert not found.offsets.any()
    assert found.credible.sum() == 1


def test_a_star_field_is_registered_by_its_stars():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    stars = rng.uniform(0, 1, (40, 2)) * (SHAPE[1], SHAPE[0])
    offsets = np.array([(1.3 * t - 3.9, -0.7 * t + 2.1) for t in range(7)])
    frames = rng.normal(size=(7, *SHAPE)).astype(np.float32)
    for t, offset in enumerate(offsets):
        for star in stars + offset:
            frames[t] += 60 * np.exp(-0.5 * ((x - star[0]) ** 2 + (y - star[1]) ** 2) / 1.2 ** 2)
    np.testing.assert_allclose(register_translation(frames).offsets, offsets, atol=0.25)


def test_a_frame_that_shows_nothing_gets_the_offset_between_its_neighbours():
    frames, offsets = panned(5)
    frames[2] = np.random.default_rng(0).normal(size=SHAPE)
    frames[6] = np.nan
    found = register_translation(frames)
    assert list(np.flatnonzero(~found.credible)) == [2, 6]
    for index in (2, 6):
        between = 0.5 * (found.offsets[index - 1] + found.offsets[index + 1])
        np.testing.assert_allclose(found.offsets[index], between, atol=1e-9)


@pytest.mark.parametrize('shape', [(1, 20, 20), (3, 1, 64), (4, 3, 3), (2, 5, 200)])
def test_any_shape_is_accepted(shape):
    frames = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    found = register_translation(frames)
    assert found.offsets.shape == (shape[0], 2)
    assert np.isfinite(found.offsets).all()


@pytest.mark.parametrize('value', [0.0, 7.0])
def test_constant_frames_stand_still(value):
    assert not register_translation(np.full((4, 32, 32), value, np.float32)).offsets.any()


def test_whole_shift_reads_the_frame_at_position_plus_offset():
    frame = np.arange(30, dtype=np.float32).reshape(5, 6)
    moved = shift_whole(frame, np.array([2, -1]))
    assert moved[3, 1] == frame[2, 3]
    assert np.isnan(moved[0]).all() and np.isnan(moved[:, 4:]).all()
    assert np.isnan(shift_whole(frame, np.array([9, 0]))).all()


def test_fractional_shift_follows_a_smooth_image():
    y, x = np.mgrid[:40, :40].astype(np.float64)

    def image(dx, dy):
        return np.sin((x + dx) / 4) + np.cos((y + dy) / 5)

    moved = shift_fraction(image(0, 0), np.array([0.3, -0.45]))
    np.testing.assert_allclose(moved[4:-4, 4:-4], image(0.3, -0.45)[4:-4, 4:-4], atol=2e-3)
