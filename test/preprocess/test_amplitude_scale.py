"""Maps of magnitude, power and decibels are told from each other and from everything else."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect.preprocess.amplitude_scale import nearly_gaussian, recognised_scale

SHAPE = (20, 48, 64)
TO = {'magnitude': np.abs, 'power': lambda z: np.abs(z)**2,
      'decibels': lambda z: 20 * np.log10(np.abs(z))}


def complex_noise(seed, shape=SHAPE):
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / 2**0.5


@pytest.mark.parametrize('scale', TO)
def test_maps_of_complex_noise_are_recognised(scale):
    for seed in range(20):
        z = complex_noise(seed)
        z[:, 20:24, 30:34] += 4
        assert recognised_scale(TO[scale](z).astype(np.float32)) == scale


@pytest.mark.parametrize('scale', TO)
def test_the_level_may_differ_from_pixel_to_pixel(scale):
    level = 10 ** np.random.default_rng(1).uniform(-2, 2, SHAPE[1:])
    assert recognised_scale(TO[scale](level * complex_noise(2)).astype(np.float32)) == scale


def test_whole_decibels_are_recognised():
    maps = np.rint(100 + TO['decibels'](complex_noise(3))).clip(0, 255)
    assert recognised_scale(maps.astype(np.float32)) == 'decibels'


def camera(rng):
    scene = ndimage.gaussian_filter(rng.standard_normal(SHAPE[1:]), 2)
    frames = 90 + 40 * scene / scene.std() + rng.uniform(0.5, 9) * rng.standard_normal(SHAPE)
    return np.rint(frames).clip(0, 255)


def panned(rng):
    scene = ndimage.gaussian_filter(rng.standard_normal((48, 64 + 5 * 20)), 2)
    scene = np.rint(90 + 40 * scene / scene.std()).clip(0, 255)
    return np.stack([scene[:, 5 * t:5 * t + 64] for t in range(20)])


@pytest.mark.parametrize('noise', [
    lambda rng: rng.standard_normal(SHAPE), lambda rng: 8000 + 25 * rng.standard_normal(SHAPE),
    # as wide as decibels, and as wide beside its mean as magnitudes
    lambda rng: 100 + 5.25 * rng.standard_normal(SHAPE),
    lambda rng: np.abs(1.91 + rng.standard_normal(SHAPE)),
    lambda rng: np.abs(rng.standard_normal(SHAPE)),
    lambda rng: rng.poisson(1.5, SHAPE), lambda rng: rng.poisson(4, SHAPE),
    lambda rng: rng.poisson(12, SHAPE), lambda rng: rng.poisson(27, SHAPE),
    lambda rng: np.rint(2 + 4 * rng.standard_normal(SHAPE)).clip(0), camera, panned])
def test_nothing_else_is_taken_for_a_map(noise):
    for seed in range(20):
        frames = noise(np.random.default_rng(seed)).astype(np.float32)
        assert recognised_scale(frames) == 'linear'


@pytest.mark.parametrize('frames', [
    np.zeros(SHAPE), np.full(SHAPE, np.nan), np.ones((2, 9, 9)),
    np.abs(complex_noise(0, (3, 9, 9))),
    1e30 * np.random.default_rng(0).standard_normal(SHAPE)])
def test_what_tells_too_little_stays_as_it_is(frames):
    assert recognised_scale(frames.astype(np.float32)) == 'linear'


@pytest.mark.parametrize('scale', TO)
def test_their_noise_becomes_nearly_gaussian(scale):
    values = nearly_gaussian(TO[scale](complex_noise(4, (40, 64, 64))).astype(np.float32), scale)
    values = (values - values.mean()) / values.std()
    assert values.dtype == np.float32
    assert abs(np.mean(values**3)) < 0.1
    assert np.mean(values**4) < 3.0
    assert values.max() < 5.0
