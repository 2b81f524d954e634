"""Shifts of the scene are found, and images are moved by them."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.preprocess.registration.registration import register

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
    found = register(frames)
    np.testing.assert_allclose(found.offsets, offsets, atol=0.1)
    assert found.credible.all()


@pytest.mark.parametrize('seed', range(3))
def test_a_bright_mover_does_not_decide(seed):
    frames, offsets = panned(seed)
    found = register(frames + mover(len(frames), 300.0))
    np.testing.assert_allclose(found.offsets, offsets, atol=0.1)


@pytest.mark.parametrize('seed', range(3))
def test_hot_pixels_do_not_decide(seed):
    frames, offsets = panned(seed)
    rng = np.random.default_rng(100 + seed)
    frames[:, rng.integers(0, SHAPE[0], 40), rng.integers(0, SHAPE[1], 40)] = 500.0
    np.testing.assert_allclose(register(frames).offsets, offsets, atol=0.2)


def test_masked_pixels_are_left_out():
    frames, offsets = panned(1)
    frames[:, 30:60, 20:70] = np.nan
    np.testing.assert_allclose(register(frames).offsets, offsets, atol=0.15)


@pytest.mark.parametrize('amplitude', [0.0, 10.0, 300.0])
def test_frames_of_noise_stand_still_whatever_moves_through_them(amplitude):
    rng = np.random.default_rng(3)
    frames = rng.normal(size=(9, *SHAPE)).astype(np.float32) + mover(9, amplitude)
    found = register(frames)
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
    np.testing.assert_allclose(register(frames).offsets, offsets, atol=0.25)


def test_a_frame_that_shows_nothing_gets_the_offset_between_its_neighbours():
    frames, offsets = panned(5)
    frames[2] = np.random.default_rng(0).normal(size=SHAPE)
    frames[6] = np.nan
    found = register(frames)
    assert list(np.flatnonzero(~found.credible)) == [2, 6]
    for index in (2, 6):
        between = 0.5 * (found.offsets[index - 1] + found.offsets[index + 1])
        np.testing.assert_allclose(found.offsets[index], between, atol=1e-9)


@pytest.mark.parametrize('spoil', [np.nan, 0.0, 1.0])
def test_a_spoiled_frame_in_the_middle_is_no_reference(spoil):
    frames, offsets = panned(6)
    frames[4] = spoil * np.random.default_rng(0).normal(size=SHAPE)
    found = register(frames)
    others = np.arange(9) != 4
    np.testing.assert_array_equal(found.credible, others)
    relative = offsets - offsets[found.reference]
    np.testing.assert_allclose(found.offsets[others], relative[others], atol=0.1)


@pytest.mark.parametrize('shape', [(1, 20, 20), (3, 1, 64), (4, 3, 3), (2, 5, 200)])
def test_any_shape_is_accepted(shape):
    frames = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    found = register(frames)
    assert found.offsets.shape == (shape[0], 2)
    assert np.isfinite(found.offsets).all()


@pytest.mark.parametrize('value', [0.0, 7.0])
def test_constant_frames_stand_still(value):
    assert not register(np.full((4, 32, 32), value, np.float32)).offsets.any()


def camera(n_frames, slope=0.0):
    """Return the maps of a camera that turns 0.5 degrees, zooms by 1 % and drifts each frame."""
    height, width = SHAPE
    middle = np.array([[1, 0, -0.5 * (width - 1)], [0, 1, -0.5 * (height - 1)], [0, 0, 1]])
    maps = []
    for t in np.arange(n_frames) - n_frames // 2:
        turn, zoom = np.deg2rad(0.5 * t), 1.01**t
        matrix = np.array([[zoom * np.cos(turn), -zoom * np.sin(turn), 1.3 * t],
                           [zoom * np.sin(turn), zoom * np.cos(turn), -0.7 * t],
                           [slope * t, -0.5 * slope * t, 1]])
        matrix = np.linalg.inv(middle) @ matrix @ middle
        maps.append(matrix / matrix[2, 2])
    return np.array(maps)


def seen_by(maps, seed, noise=0.5, texture=10.0):
    """Return frames of a rough scene seen through ``maps`` from the plane to each frame."""
    rng = np.random.default_rng(seed)
    margin = 60
    scene = ndimage.gaussian_filter(
        rng.normal(size=(SHAPE[0] + 2 * margin, SHAPE[1] + 2 * margin)), 2.0)
    scene *= texture / scene.std()
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    pixels = np.stack([x, y], axis=-1)
    frames = []
    for back in geometry.inverse(maps):
        at = geometry.apply(back, pixels) + margin
        frames.append(ndimage.map_coordinates(scene, [at[..., 1], at[..., 0]], order=3))
    return (np.array(frames) + rng.normal(0, noise, (len(maps), *SHAPE))).astype(np.float32)


def farthest_off(found, maps):
    """Return the largest error of maps anywhere in the image, in pixels."""
    y, x = np.mgrid[:SHAPE[0]:9, :SHAPE[1]:9]
    points = np.stack([x, y], axis=-1)
    errors = [geometry.apply(a, points) - geometry.apply(b, points)
              for a, b in zip(found, maps, strict=True)]
    return float(np.max(np.hypot(*np.moveaxis(errors, -1, 0))))


@pytest.mark.parametrize(('model', 'slope'), [('affine', 0.0), ('homography', 1e-5)])
@pytest.mark.parametrize('seed', range(2))
def test_a_turning_and_zooming_camera_is_followed_below_a_fifth_of_a_pixel(model, slope, seed):
    maps = camera(13, slope)
    frames = seen_by(maps, seed) + mover(13, 100.0)
    found = register(frames, model)
    assert found.credible.all() and found.refined.all()
    assert farthest_off(found.maps, maps) < 0.2


def test_a_long_pan_with_turns_is_followed_beyond_the_view_of_the_reference():
    steps = np.array([(9.0 * t, -2.0 * t) for t in np.arange(11) - 5])
    maps = geometry.translations(steps) @ camera(11)
    found = register(seen_by(maps, 3), 'affine')
    assert found.refined.all()
    assert farthest_off(found.maps, maps) < 0.4


@pytest.mark.parametrize('model', ['affine', 'homography'])
def test_frames_of_noise_get_no_map(model):
    frames = np.random.default_rng(3).normal(size=(7, *SHAPE)).astype(np.float32)
    found = register(frames + mover(7, 300.0), model)
    np.testing.assert_array_equal(found.maps, np.tile(np.eye(3), (7, 1, 1)))
    assert found.credible.sum() == 1


def test_a_scene_in_one_corner_tells_no_more_than_its_shift():
    frames, offsets = panned(2)
    noise = np.random.default_rng(1).normal(0, 0.5, frames.shape).astype(np.float32)
    noise[:, :48, :48] = frames[:, :48, :48]
    found = register(noise, 'homography')
    assert found.credible.all() and found.refined.sum() == 1
    np.testing.assert_allclose(found.offsets, offsets, atol=0.4)


def test_a_turning_star_field_is_followed_by_its_stars():
    rng = np.random.default_rng(4)
    maps = camera(7)
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    stars = rng.uniform(0, 1, (60, 2)) * (SHAPE[1], SHAPE[0])
    frames = rng.normal(size=(7, *SHAPE)).astype(np.float32)
    for frame, matrix in zip(frames, maps, strict=True):
        for star in geometry.apply(matrix, stars):
            frame += 60 * np.exp(-0.5 * ((x - star[0])**2 + (y - star[1])**2) / 1.2**2)
    assert farthest_off(register(frames, 'affine').maps, maps) < 0.6


def test_hot_pixels_do_not_decide_on_a_map():
    maps = camera(7)
    frames = seen_by(maps, 5)
    rng = np.random.default_rng(105)
    frames[:, rng.integers(0, SHAPE[0], 40), rng.integers(0, SHAPE[1], 40)] = 500.0
    assert farthest_off(register(frames, 'affine').maps, maps) < 0.3


@pytest.mark.parametrize('shape', [(1, 20, 20), (3, 1, 64), (4, 3, 3), (2, 5, 200)])
@pytest.mark.parametrize('value', ['noise', 'constant'])
def test_any_frames_get_finite_maps(shape, value):
    frames = np.ones(shape, np.float32)
    if value == 'noise':
        frames = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    found = register(frames, 'homography')
    assert found.maps.shape == (shape[0], 3, 3)
    assert np.isfinite(found.maps).all()
