"""Covariance of positions: the bound where it is known, and the errors of simulated targets."""

from itertools import product

import numpy as np
import pytest

from track_before_detect import detect
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.motions import centred_path
from track_before_detect.simulation.sensor import add_path
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.refine.refinement import refiner_for
from track_before_detect.types import FrameBatch

T, SIDE = 16, 32
THRESHOLDS = {'constant': 6.0, 'fluctuating': 8.0}
# Squared error over its covariance, two where that is right. Laid down before it was measured.
LEAST, MOST = 1.6, 2.5


def bound(amplitude, sigma=1.0):
    """Return the Cramer-Rao bound of a constant velocity, per axis, shape (T,)."""
    t = np.arange(T) - (T - 1) / 2
    return 2 * sigma**2 / amplitude**2 * (1 / T + t**2 / np.sum(t**2))


def line(shape=(SIDE, SIDE)):
    t = np.arange(T)
    return np.column_stack([10.3 + 0.7 * t, np.where(shape[0] > 1, 22.6 - 0.4 * t, 0.0)])


def covariance(frames, positions, **options):
    detector = ConvexDetector(DetectorOptions(threshold=6.0, **options))
    targets = detector.task(FrameBatch.of(frames), 6.0).targets
    return refiner_for(targets).covariance(frames, positions)


@pytest.mark.parametrize('sigma', [0.8, 1.5])
@pytest.mark.parametrize('kind', ['constant', 'fluctuating'])
def test_bright_straight_target_has_the_cramer_rao_bound(kind, sigma):
    frames = np.zeros((T, SIDE, SIDE), np.float32)
    add_path(frames, line(), sigma, 100.0)
    found = covariance(frames, line(), amplitude_model=kind, psf_sigma_px=sigma)
    np.testing.assert_allclose(found[:, 0, 0], bound(100.0, sigma), rtol=0.02)
    np.testing.assert_allclose(found[:, 1, 1], bound(100.0, sigma), rtol=0.02)
    np.testing.assert_allclose(found[:, 0, 1], 0.0, atol=1e-9)


def test_complex_noise_has_half_its_variance_in_each_part():
    frames = np.zeros((T, SIDE, SIDE), np.float32)
    add_path(frames, line(), 1.0, 100.0)
    phases = np.exp(1j * np.arange(T))[:, None, None].astype(np.complex64)
    found = covariance(frames * phases, line(), amplitudes='complex')
    np.testing.assert_allclose(found[:, 0, 0], 0.5 * bound(100.0), rtol=0.02)


def test_frames_in_which_the_target_is_dim_tell_less():
    frames = np.zeros((T, SIDE, SIDE), np.float32)
    add_path(frames, line(), 1.0, np.where(np.arange(T) < T // 2, 100.0, 20.0))
    found = covariance(frames, line())[:, 0, 0]
    assert found[-1] > 4 * found[0] > 4 * bound(100.0)[0]


def test_target_is_known_where_it_is_present_alone():
    frames = np.zeros((T, SIDE, SIDE), np.float32)
    path = line()
    path[:4] = np.nan
    add_path(frames[4:], path[4:], 1.0, 30.0)
    found = covariance(frames, path, presence='partial')
    assert np.isnan(found[:4]).all() and (np.linalg.det(found[4:]) > 0).all()


def test_nothing_is_uncertain_across_frames_of_one_row():
    path = line((1, SIDE))
    frames = np.zeros((T, 1, SIDE), np.float32)
    for frame, x in zip(frames, path[:, 0], strict=True):
        frame[0] = 30 * np.exp(-0.5 * (np.arange(SIDE) - x)**2)
    found = covariance(frames, path)
    assert (found[:, 0, 0] > 0).all()
    assert not found[:, 1].any() and not found[:, :, 1].any()


def errors_of(motion, kind, snr, n_targets):
    """Return the squared errors of found targets over their covariances, shape (N, T)."""
    found = []
    for number in range(n_targets):
        rng = np.random.default_rng([15, number, int(snr), motion == 'arc', kind == 'constant'])
        speed = rng.uniform(0.2, 1.0)
        turn = rng.choice((-1, 1)) * speed / 20 if motion == 'arc' else 0.0
        truth = centred_path(rng.uniform(0, 2 * np.pi), speed, turn, T)
        truth = truth + (SIDE - 1) / 2 + rng.uniform(-2, 2, 2)
        amplitudes = np.full(T, snr)
        if kind == 'fluctuating':
            amplitudes *= np.sqrt(rng.exponential(size=T))
        frames = rng.standard_normal((T, SIDE, SIDE), np.float32)
        add_path(frames, truth, 1.0, amplitudes)
        result = detect(frames, amplitude_model=kind, threshold=THRESHOLDS[kind])
        near = [(one, one.positions - truth) for one in result.trajectories
                if np.linalg.norm(one.positions - truth, axis=1).mean() < 3]
        for one, error in near[:1]:
            found.append(np.einsum('ti,tij,tj->t', error, np.linalg.inv(one.covariance), error))
    assert len(found) > 0.8 * n_targets
    return np.array(found)


def test_errors_of_simulated_targets_are_as_large_as_their_covariances_say():
    pooled = {}
    for motion, kind, snr in product(('line', 'arc'), ('constant', 'fluctuating'), (3.0, 6.0)):
        pooled[motion, kind, snr] = errors_of(motion, kind, snr, 20)
    for case, errors in pooled.items():
        each = errors.mean(axis=1)
        # A case has too few targets to tell more than what lies beyond its own uncertainty.
        uncertainty = 2.6 * each.std() / np.sqrt(len(each))
        assert LEAST - uncertainty < each.mean() < MOST + uncertainty, case
    errors = np.concatenate(list(pooled.values()))
    assert LEAST < errors.mean() < MOST
    # Of normal errors 1 % lie outside the ellipse.
    assert np.mean(errors > 9.21) < 0.03
