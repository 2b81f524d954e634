"""One target is one trajectory when the PSF is wrong, and two are two when it is right."""

import logging
import re

import numpy as np
import pytest

from track_before_detect.kernels.amplitude_codes import CONSTANT, NON_NEGATIVE
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.convex.extended_target import together
from track_before_detect.solvers.convex.working_set import WorkingSet

T = 20
TIMES = np.arange(float(T))
LINE = (np.array([20.3, 18.6]) + np.array([0.35, -0.2]) * (TIMES[:, None] - 9.5))


def scene(targets, seed, shape=(36, 38), kind=np.float32):
    """Return frames of noise with targets: path (T, 2), amplitude (T,) or one, sigma."""
    rng = np.random.default_rng(seed)
    frames = np.zeros((T, *shape), np.float32)
    for path, amplitude, sigma in targets:
        for frame, (x, y), level in zip(frames, path, np.broadcast_to(amplitude, T), strict=True):
            add_target(frame, x, y, sigma, level)
    noise = rng.standard_normal(frames.shape)
    if kind is np.complex64:
        phase = np.exp(2j * np.pi * rng.random((T, 1, 1)))
        noise = (noise + 1j * rng.standard_normal(frames.shape)) / 2**0.5
        return (frames * phase + noise).astype(kind)
    return frames + noise.astype(np.float32)


def found_in(frames, **options):
    options = {'threshold': 8.0, 'max_speed_px_s': 0.8, **options}
    return ConvexDetector(DetectorOptions(**options)).detect(frames, TIMES).found


def errors(found, path):
    return sorted(float(np.linalg.norm(one.positions - path, axis=1).mean()) for one in found)


@pytest.mark.parametrize(('sigma', 'snr'), [(1.3, 10.0), (1.5, 30.0)])
def test_target_wider_than_the_psf_is_one_trajectory(sigma, snr, caplog):
    frames = scene([(LINE, snr, sigma)], 1)
    with caplog.at_level(logging.WARNING):
        found = found_in(frames)
    assert len(found) == 1
    # The error of a path fitted with the true PSF is about this.
    assert errors(found, LINE)[0] < 3 * sigma / snr
    [message] = caplog.messages
    said = re.fullmatch(r'the targets look (\S+) px wide, psf_sigma_px is 1', message)
    assert float(said[1]) == pytest.approx(sigma, abs=0.11)


def test_target_is_found_by_a_psf_whose_energy_lies_beside_its_middle():
    psf = np.zeros((7, 7), np.float32)
    add_target(psf, 5.0, 4.0, 1.0, 1.0)
    frames = scene([(LINE + np.array([2.0, 1.0]), 30.0, 1.3)], 5)
    found = found_in(frames, psf=psf)
    assert len(found) == 1 and found[0].statistic > 100
    assert errors(found, LINE)[0] < 0.2


def test_right_psf_is_not_doubted(caplog):
    with caplog.at_level(logging.WARNING):
        assert len(found_in(scene([(LINE, 50.0, 1.0)], 2))) == 1
    assert not caplog.messages


@pytest.mark.parametrize('options', [
    {'amplitudes': 'signed'}, {'amplitudes': 'complex'},
    {'amplitude_model': 'constant', 'threshold': 6.0},
    {'amplitudes': 'complex', 'amplitude_model': 'constant'},
], ids=['signed', 'complex', 'constant', 'one modulus'])
def test_other_amplitudes_have_no_ghosts_either(options):
    kind = np.complex64 if options.get('amplitudes') == 'complex' else np.float32
    frames = scene([(LINE, 15.0, 1.4)], 3, kind=kind)
    found = found_in(frames, **{'threshold': 9.0, **options})
    assert len(found) == 1
    assert errors(found, LINE)[0] < 0.2


def test_masked_pixels_and_uneven_noise_leave_one_trajectory():
    frames = scene([(LINE, 15.0, 1.4)], 4)
    weights = np.ones((1, 36, 38), np.float32)
    weights[:, :, 22:] = 0.5
    weights[:, 17, 19] = 0.0
    frames[:, :, 22:] = 0.5 * scene([(LINE, 15.0, 1.4)], 4)[:, :, 22:]
    frames[:, :, 22:] += 0.87 * np.random.default_rng(5).standard_normal((T, 36, 16))
    frames[:, 17, 19] = 0.0
    detector = ConvexDetector(DetectorOptions(threshold=8.0, max_speed_px_s=0.8))
    found = detector.detect_weighted(frames.astype(np.float32), TIMES, weights).found
    assert len(found) == 1


@pytest.mark.parametrize(('first', 'second', 'distance'), [
    (4.0, 4.0, 3.0), (50.0, 50.0, 3.0), (25.0, 5.0, 3.0), (25.0, 5.0, 5.0)])
def test_two_targets_of_the_given_psf_stay_two(first, second, distance):
    aside = distance * np.array([0.6, 0.8])
    found = found_in(scene([(LINE, first, 1.0), (LINE + aside, second, 1.0)], 6))
    assert len(found) == 2
    assert errors(found, LINE)[0] < 0.5
    assert errors(found, LINE + aside)[0] < 0.5


def test_two_wide_targets_are_two_trajectories():
    aside = np.array([6.4, 4.8])
    found = found_in(scene([(LINE, 25.0, 1.3), (LINE + aside, 6.0, 1.3)], 7))
    assert len(found) == 2
    assert errors(found, LINE + aside)[0] < 0.5


@pytest.mark.parametrize(('targets', 'sigma'), [((0.0,), 2.7), ((-2.5, 2.5), 2.0)],
                         ids=['wide target', 'pair'])
def test_targets_on_a_line_are_counted(targets, sigma):
    path = np.stack([30 + 0.1 * TIMES, np.zeros(T)], axis=1)
    snr = 25.0 if len(targets) == 1 else 6.0
    frames = scene([(path + [place, 0.0], snr, sigma) for place in targets], 8, (1, 64))
    assert len(found_in(frames, psf_sigma_px=2.0, threshold=7.0)) == len(targets)


@pytest.mark.parametrize('code', [NON_NEGATIVE, CONSTANT])
def test_parts_together_explain_most(code):
    rng = np.random.default_rng(9)
    model = AMPLITUDE_MODELS[code]
    parts = rng.standard_normal((12, 2)) + [1.0, 0.8]
    gram = parts.T @ parts
    brightness = np.full(T, 3.0) if code == CONSTANT else rng.uniform(1, 5, T)
    data = (parts @ [1.0, 0.5])[:, None] * brightness + 0.3 * rng.standard_normal((12, T))
    overlaps = np.repeat(gram[:, :, None], T, axis=2)
    mixture, seen, envelope = together(parts.T @ data, overlaps, model)
    best = 0.0
    for angle in np.linspace(0, 2 * np.pi, 2000):
        stamp = parts @ [np.cos(angle), np.sin(angle)]
        best = max(best, model.statistic(stamp @ data / np.linalg.norm(stamp), envelope))
    assert model.statistic(seen, envelope) == pytest.approx(best, rel=1e-4)
    np.testing.assert_allclose(np.einsum('it,jt,ijt->t', mixture, mixture, overlaps), 1.0)


def test_frames_without_some_paths_are_lent_and_given_back():
    frames = scene([(LINE, 9.0, 1.0)], 10)
    paths = WorkingSet(frames, np.zeros((0, 0, 0)), GaussianPsf(1.0), 8.0,
                    AMPLITUDE_MODELS[NON_NEGATIVE])
    for shift, amplitude in ((0.0, 8.0), (2.0, 3.0), (4.0, 1.0)):
        paths.add(LINE + shift, 0.0)
        paths.assign(np.array([len(paths) - 1]), np.full((1, T), amplitude))
    before = paths.residual.copy()
    left = paths.residual_statistic(1)
    with paths.without(0, 2) as lent:
        np.testing.assert_allclose(paths.residual_statistic(1), paths.matched[1] - 3.0, atol=1e-4)
        assert lent is paths.residual
    np.testing.assert_allclose(paths.residual, before, atol=1e-5)
    np.testing.assert_allclose(left, paths.seen(1) - 3.0, atol=1e-4)
