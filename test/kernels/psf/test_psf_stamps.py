"""Stamps are unit norm, cut at borders, weighed, and equal a picture drawn pixel by pixel."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels.amplitude_codes import COMPLEX, SIGNED
from track_before_detect.kernels.psf import psf_stamps as kernel
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf

SHAPE = (11, 14)
T = 4
POSITIONS = np.array([[5.2, 4.9], [0.0, 10.0], [13.0, 0.4], [6.5, 6.5]])
LOPSIDED = np.add.outer(np.arange(5.0), np.arange(7.0)**2) + np.eye(5, 7, 1) * 9
PSFS = {
    'gaussian': GaussianPsf(1.0),
    'integrated': GaussianPsf(0.8, integrated=True),
    'array': ArrayPsf(LOPSIDED),
}


def weights_of(kind):
    """Return weights (T, H, W), (1, H, W) or none."""
    generator = np.random.default_rng(1)
    return {
        'none': np.zeros((0, 0, 0), np.float32),
        'mask': (generator.random((T, *SHAPE)) > 0.3).astype(np.float32),
        'map': generator.uniform(0.3, 2, (1, *SHAPE)).astype(np.float32),
    }[kind]


def render(psf, positions, weights):
    optics = psf.optics()
    size = 2 * optics.half + 1
    stamps = np.empty((len(positions), size, size))
    origins = np.empty((len(positions), 2), np.int64)
    norms = np.empty(len(positions))
    kernel.render(optics, positions, *SHAPE, weights, stamps, origins, norms)
    return stamps, origins, norms


def drawn(psf, positions, weights, amplitudes):
    stamps, origins, _ = render(psf, positions, weights)
    frames = np.zeros((len(positions), *SHAPE), np.asarray(amplitudes).dtype)
    kernel.accumulate(frames, stamps, origins, amplitudes)
    return frames


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('kind', ['none', 'mask', 'map'])
def test_drawn_stamps_and_norms_equal_the_picture(name, kind):
    psf, weights = PSFS[name], weights_of(kind)
    frames = drawn(psf, POSITIONS, weights, np.arange(1.0, 5))
    _, _, norms = render(psf, POSITIONS, weights)
    for t, position in enumerate(POSITIONS):
        whole = naive.psf_picture(psf, position)
        picture = naive.cut(whole, SHAPE)
        if len(weights):
            picture = picture * weights[t % len(weights)]
        left = np.linalg.norm(picture)
        np.testing.assert_allclose(frames[t], (t + 1) * picture / left, atol=2e-6)
        assert norms[t] == pytest.approx(left / np.linalg.norm(whole), abs=1e-5)


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('kind', ['none', 'mask', 'map'])
@pytest.mark.parametrize('dtype', [np.float32, np.complex64])
def test_correlation_is_the_adjoint_of_drawing(name, kind, dtype):
    generator = np.random.default_rng(2)
    stamps, origins, _ = render(PSFS[name], POSITIONS, weights_of(kind))
    amplitudes = generator.standard_normal((2, T)).T @ [1, 0 if dtype == np.float32 else 1j]
    data = (generator.standard_normal((2, T, *SHAPE)).transpose(1, 2, 3, 0) @ [1, 1j]).astype(
        dtype) if dtype == np.complex64 else generator.standard_normal((T, *SHAPE)).astype(dtype)
    amplitudes = np.ascontiguousarray(amplitudes)
    picture = np.zeros_like(data)
    kernel.accumulate(picture, stamps, origins, amplitudes)
    seen = np.empty(T, amplitudes.dtype)
    kernel.correlate(stamps, origins, data, seen)
    assert np.vdot(picture, data) == pytest.approx(np.vdot(amplitudes, seen), rel=1e-5)


@pytest.mark.parametrize('name', PSFS)
def test_overlap_is_the_inner_product_of_two_pictures(name):
    others = POSITIONS + np.array([[1.3, -0.6], [3.0, -2.0], [-7.9, 0.0], [-20, 0]])
    others = np.clip(others, 0, [SHAPE[1] - 1, SHAPE[0] - 1])
    psf, weights = PSFS[name], weights_of('mask')
    out = np.empty(T)
    kernel.overlap(*render(psf, POSITIONS, weights)[:2], *render(psf, others, weights)[:2], out)
    ones = np.ones(T)
    expected = np.einsum('tyx,tyx->t', drawn(psf, POSITIONS, weights, ones),
                         drawn(psf, others, weights, ones))
    np.testing.assert_allclose(out, expected, atol=1e-9)


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('kind', ['none', 'mask', 'map'])
@pytest.mark.parametrize('code', [SIGNED, COMPLEX])
def test_statistic_equals_stamp_and_slope_equals_difference_quotient(name, kind, code):
    generator = np.random.default_rng(4)
    psf, weights = PSFS[name], weights_of(kind)
    data = generator.standard_normal((T, *SHAPE)).astype(np.float32)
    if code == COMPLEX:
        data = (data + 1j * generator.standard_normal(data.shape)).astype(np.complex64)
    if kind == 'mask':
        data[weights == 0] = 0

    def statistic(positions):
        out, norms = np.empty((T, 3)), np.empty(T)
        kernel.statistic_and_slope(psf.optics(), positions, data, weights, code, out, norms)
        return out, norms

    stamps, origins, norms = render(psf, POSITIONS, weights)
    seen = np.empty(T, data.dtype)
    kernel.correlate(stamps, origins, data, seen)
    out, own_norms = statistic(POSITIONS)
    np.testing.assert_allclose(out[:, 0], np.abs(seen) if code == COMPLEX else seen, atol=1e-6)
    np.testing.assert_allclose(own_norms, 1.0 if kind == 'none' else norms)
    for axis in (0, 1):
        moved = POSITIONS.copy()
        moved[:, axis] += 1e-5
        slope = (statistic(moved)[0][:, 0] - out[:, 0]) / 1e-5
        # Where a stamp moves by a whole pixel it is another one.
        smooth = np.abs(moved[:, axis] % 1 - 0.5) > 1e-4
        np.testing.assert_allclose(out[smooth, 1 + axis], slope[smooth], atol=5e-3)


@pytest.mark.parametrize('name', PSFS)
def test_stamp_without_a_valid_pixel_is_zero(name):
    stamps, _, norms = render(PSFS[name], POSITIONS, np.zeros((T, *SHAPE), np.float32))
    assert not stamps.any()
    assert not norms.any()
