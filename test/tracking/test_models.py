"""Every model of PSF and noise, from frames to trajectories."""

import numpy as np
import pytest

from false_alarms import assert_rate_is_realised
import naive
import track_before_detect as tbd
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf

T, SHAPE = 8, (24, 30)
SPEED = np.array([0.43, -0.27])
START = np.array([9.3, 14.2])
PATH = START + SPEED * np.arange(T)[:, None]
Y, X = np.mgrid[-6:7, -6:7]
ARRAY = np.exp(-((X + Y)**2 / 3.0**2 + (X - Y)**2 / 1.6**2) / 2)
PSFS = {
    'gaussian': (GaussianPsf(1.0), {}),
    'integrated': (GaussianPsf(0.7, integrated=True),
                   {'psf_sigma_px': 0.7, 'psf_model': 'integrated_gaussian'}),
    'array': (ArrayPsf(ARRAY), {'psf': 7 * ARRAY}),
}


def picture(psf, positions, amplitudes, shape=SHAPE):
    """Return frames of a target of given amplitudes of the whole unit-norm PSF."""
    frames = []
    for position, amplitude in zip(positions, amplitudes, strict=True):
        whole = naive.psf_picture(psf, position)
        frames.append(amplitude * naive.cut(whole, shape) / np.linalg.norm(whole))
    return np.array(frames)


def detect(frames, **options):
    return tbd.detect(frames, threshold=8.0, **options).trajectories


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_noise_free_target_is_recovered(name, detector):
    psf, options = PSFS[name]
    [found] = detect(picture(psf, PATH, np.full(T, 10.0)), detector=detector, **options)[:1]
    error = np.abs(found.positions - PATH).max()
    # The greedy method stays on the grid.
    assert error < (0.05 if detector == 'convex' else 1.0)
    if detector == 'convex':
        np.testing.assert_allclose(found.amplitudes, 10.0, rtol=2e-3)


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('noise', ['variance', 'variances', 'mask', 'masks'])
def test_noise_free_target_is_recovered_under_variance_and_mask(name, noise):
    psf, options = PSFS[name]
    generator = np.random.default_rng(5)
    shape = (T, *SHAPE) if noise.endswith('s') else SHAPE
    amplitudes = np.linspace(20, 30, T)
    frames = picture(psf, PATH, amplitudes)
    if noise.startswith('mask'):
        options = {**options, 'mask': generator.random(shape) < 0.3}
        frames = np.where(options['mask'], 1e6, frames)
    else:
        options = {**options, 'variance': generator.uniform(0.2, 4.0, shape)}
    found = detect(frames, **options)
    assert len(found) == 1
    assert np.abs(found[0].positions - PATH).max() < 0.05
    np.testing.assert_allclose(found[0].amplitudes, amplitudes, rtol=5e-3)


def test_amplitude_is_that_of_the_whole_target_at_the_border():
    path = np.tile([0.0, 11.3], (T, 1))
    [found] = detect(picture(GaussianPsf(1.0), path, np.full(T, 15.0)), motion_model='static')
    np.testing.assert_allclose(found.positions, path, atol=0.05)
    np.testing.assert_allclose(found.amplitudes, 15.0, rtol=5e-3)


def test_variance_decides_where_a_target_can_be_seen():
    frames = picture(GaussianPsf(1.0), PATH, np.full(T, 6.0))
    assert detect(frames, variance=np.ones(SHAPE))
    assert not detect(frames, variance=np.full(SHAPE, 16.0))


def test_amplitudes_do_not_depend_on_the_units():
    generator = np.random.default_rng(7)
    frames = picture(GaussianPsf(1.0), PATH, np.full(T, 9.0)) + generator.standard_normal(
        (T, *SHAPE))
    variance = generator.uniform(0.5, 2.0, SHAPE)
    [plain] = detect(frames, variance=variance)
    [scaled] = detect(50 * frames, variance=2500 * variance)
    np.testing.assert_allclose(scaled.positions, plain.positions, atol=1e-3)
    np.testing.assert_allclose(scaled.amplitudes, 50 * plain.amplitudes, rtol=1e-3)
    assert scaled.statistic == pytest.approx(plain.statistic, rel=1e-4)


def test_infinite_variance_masks_a_pixel():
    frames = picture(GaussianPsf(1.0), PATH, np.full(T, 20.0))
    mask = np.random.default_rng(8).random(SHAPE) < 0.2
    [masked] = detect(frames, mask=mask)
    [infinite] = detect(frames, variance=np.where(mask, np.inf, 1.0))
    np.testing.assert_allclose(infinite.positions, masked.positions, atol=1e-3)


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('shape', [(1, 40), (40, 1)])
def test_sensors_of_one_line_are_searched(name, shape):
    psf, options = PSFS[name]
    path = np.zeros((T, 2))
    path[:, 0 if shape[0] == 1 else 1] = 12.3 + 0.4 * np.arange(T)
    [found] = detect(picture(psf, path, np.full(T, 40.0), shape), **options)
    np.testing.assert_allclose(found.positions, path, atol=0.05)


@pytest.mark.parametrize('name', PSFS)
def test_a_single_frame_is_searched(name):
    psf, options = PSFS[name]
    [found] = detect(picture(psf, PATH[:1], [20.0]), **options)
    np.testing.assert_allclose(found.positions, PATH[:1], atol=0.05)
    np.testing.assert_allclose(found.amplitudes, 20.0, rtol=5e-3)


@pytest.mark.parametrize(('options', 'words'), [
    ({'psf': np.ones((4, 5))}, 'odd'), ({'psf': np.zeros((3, 3))}, 'zero'),
    ({'psf': np.ones(5)}, '2-D'), ({'variance': np.ones((3, 3))}, 'variance'),
    ({'variance': np.zeros(SHAPE)}, 'above 0'), ({'mask': np.zeros((T - 1, *SHAPE))}, 'frame 7'),
    ({'variance': np.ones(SHAPE), 'noise': 'map'}, 'noise'),
    ({'psf': ARRAY, 'detector': 'cfo_dp'}, 'Gaussian')])
def test_what_cannot_be_used_is_refused_in_one_sentence(options, words):
    with pytest.raises(tbd.TbdError, match=words) as error:
        detect(np.zeros((T, *SHAPE)), **options)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('continuation', [(1.0,), (1.0, 0.5, 0.0)])
def test_noise_free_complex_target_is_recovered_with_its_phases(name, continuation):
    psf, options = PSFS[name]
    phases = np.exp(1j * np.random.default_rng(4).uniform(0, 2 * np.pi, T))
    amplitudes = np.linspace(40, 60, T) * phases
    result = tbd.detect(picture(psf, PATH, amplitudes), threshold=8.0, amplitudes='complex',
                        continuation=continuation, **options)
    assert np.abs(result.trajectories[0].positions - PATH).max() < 0.05
    if continuation == (1.0,):
        assert result.gap < 0.05 * result.history[-1].objective
    else:
        [found] = result.trajectories
        np.testing.assert_allclose(found.amplitudes, amplitudes, rtol=5e-3)
        assert found.snr == pytest.approx(50, rel=1e-2)


@pytest.mark.parametrize('masked', [False, True])
def test_real_part_of_a_complex_scene_is_that_of_a_signed_one(masked):
    # Frames without an imaginary part have signed amplitudes.
    generator = np.random.default_rng(3)
    frames = picture(GaussianPsf(1.0), PATH, 12 * generator.choice([-1, 1], T))
    frames += generator.standard_normal(frames.shape)
    options = {'mask': generator.random(SHAPE) < 0.1} if masked else {}
    signed = detect(frames, amplitudes='signed', **options)
    as_complex = detect(frames.astype(complex), amplitudes='complex', **options)
    assert len(signed) == len(as_complex) > 0
    for one, other in zip(signed, as_complex, strict=True):
        np.testing.assert_allclose(other.positions, one.positions, atol=1e-3)
        np.testing.assert_allclose(other.amplitudes, one.amplitudes, atol=1e-2)
        assert other.statistic == pytest.approx(one.statistic, rel=1e-4)


@pytest.mark.parametrize(('dtype', 'options', 'words'), [
    (float, {'amplitudes': 'complex'}, 'non-negative or signed'),
    (complex, {'amplitudes': 'signed'}, 'amplitudes complex'),
    (complex, {'amplitudes': 'complex', 'amplitude_model': 'constant', 'presence': 'partial'},
     'presence=partial with amplitudes=complex and amplitude_model=constant'),
    (complex, {'detector': 'cfo_dp'}, 'complex')])
def test_frames_and_amplitudes_that_do_not_go_together_are_refused(dtype, options, words):
    with pytest.raises(tbd.TbdError, match=words):
        detect(np.zeros((T, *SHAPE), dtype), **options)


@pytest.mark.parametrize('sign', [1, -1])
@pytest.mark.parametrize('noise', ['none', 'variance', 'variances', 'mask', 'masks'])
@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_what_is_constant_is_the_amplitude_of_the_target_itself(detector, noise, sign):
    generator = np.random.default_rng(6)
    shape = (T, *SHAPE) if noise.endswith('s') else SHAPE
    frames = picture(GaussianPsf(1.0), PATH, np.full(T, sign * 25.0))
    options = {'motion_model': 'constant_velocity'}
    if noise.startswith('mask'):
        options['mask'] = generator.random(shape) < 0.3
        frames = np.where(options['mask'], 1e6, frames)
    elif noise.startswith('variance'):
        options['variance'] = generator.uniform(0.2, 4.0, shape)
    found = detect(frames, amplitude_model='constant', amplitudes='signed', detector=detector,
                   **options)[0]
    tolerance = 5e-3 if detector == 'convex' else 0.2
    np.testing.assert_allclose(found.amplitudes, sign * 25.0, rtol=tolerance)
    assert np.ptp(found.amplitudes) < 1e-3
    assert np.abs(found.positions - PATH).max() < (0.05 if detector == 'convex' else 1.0)
    # The statistic is that of the amplitude over the noise left to it.
    if noise == 'none':
        assert found.statistic == pytest.approx(25 * np.sqrt(T), rel=1e-2 + tolerance)
        assert found.snr == pytest.approx(sign * 25, rel=tolerance)


@pytest.mark.parametrize('noise', ['none', 'variances', 'mask'])
@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_what_is_constant_of_a_complex_target_is_its_modulus(detector, noise):
    generator = np.random.default_rng(6)
    phases = np.exp(2j * np.pi * generator.random(T))
    frames = picture(GaussianPsf(1.0), PATH, 25 * phases)
    options = {'motion_model': 'constant_velocity'}
    if noise == 'mask':
        options['mask'] = generator.random(SHAPE) < 0.3
        frames[:, options['mask']] = 1e6
    elif noise == 'variances':
        options['variance'] = generator.uniform(0.2, 4.0, (T, *SHAPE))
    [found, *_] = detect(frames, amplitude_model='constant', amplitudes='complex',
                         detector=detector, **options)
    tolerance = 5e-3 if detector == 'convex' else 0.2
    np.testing.assert_allclose(np.abs(found.amplitudes), 25.0, rtol=tolerance)
    assert np.ptp(np.abs(found.amplitudes)) < 1e-3
    assert np.abs(np.angle(found.amplitudes / phases)).max() < tolerance
    assert np.abs(found.positions - PATH).max() < (0.05 if detector == 'convex' else 1.0)
    if noise == 'none':
        assert found.statistic == pytest.approx(25 * np.sqrt(T), rel=1e-2 + tolerance)


def test_dark_target_is_found_when_constant_amplitudes_are_signed():
    generator = np.random.default_rng(9)
    frames = generator.standard_normal((T, *SHAPE))
    frames -= picture(GaussianPsf(1.0), PATH, np.full(T, 5.0))
    [found] = detect(frames, amplitudes='signed', amplitude_model='constant')
    assert np.abs(found.positions - PATH).max() < 1.0
    assert -6.0 < found.amplitudes.mean() < -4.0
    assert not detect(frames, amplitude_model='constant')


@pytest.mark.parametrize('presence', ['full', 'partial'])
def test_constant_amplitudes_of_either_sign_are_those_of_the_turned_frames(presence):
    generator = np.random.default_rng(10)
    frames = generator.standard_normal((T, *SHAPE))
    frames += picture(GaussianPsf(1.0), PATH, np.full(T, 6.0))
    options = {'amplitudes': 'signed', 'amplitude_model': 'constant', 'presence': presence,
               'mask': generator.random(SHAPE) < 0.1}
    [bright], [dark] = detect(frames, **options), detect(-frames, **options)
    np.testing.assert_allclose(dark.positions, bright.positions, atol=1e-6)
    np.testing.assert_allclose(dark.amplitudes, -bright.amplitudes, rtol=1e-6)
    assert dark.statistic == pytest.approx(bright.statistic, rel=1e-6)


def test_masked_noise_holds_as_many_constant_targets_as_asked_for(calibrate_on):
    calibrate_on(500)

    def passes(generator):
        frames = generator.standard_normal((6, 32, 32))
        return bool(tbd.detect(
            frames, amplitudes='signed', amplitude_model='constant', psf_sigma_px=2.0,
            false_alarm_rate=0.3, mask=generator.random(frames.shape) < 0.1).trajectories)

    assert_rate_is_realised(passes, 0.3, 120, 12)
