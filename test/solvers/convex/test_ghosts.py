"""One target is one trajectory when the PSF is wrong, and two are two when it is right."""

import functools
import logging
import re

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.kernels.amplitude_codes import CONSTANT, NON_NEGATIVE
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS, NonNegative
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_streak, add_target
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.convex.extended_target import together
from track_before_detect.solvers.fit.working_set import Source, StampRenderer, WorkingSet
from track_before_detect.types import FrameBatch

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
    return ConvexDetector(DetectorOptions(**options)).detect(FrameBatch.of(frames, TIMES)).found


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
    found = detector.detect(FrameBatch.of(frames.astype(np.float32), TIMES), weights).found
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


def entering(offsets, sigma, snr, **options):
    """Find targets that enter in the sixth frame."""
    paths = [LINE + offset for offset in offsets]
    frames = scene([(path, snr * (TIMES >= 5), sigma) for path in paths], 21)
    found = tbd.detect(frames, TIMES, presence='partial', threshold=8.5, max_speed_px_s=0.8,
                       **options).trajectories
    return found, [np.where(TIMES[:, None] >= 5, path, np.nan) for path in paths]


def smeared(offsets, sigma, snr):
    """Find targets that move by two pixels while the shutter is open."""
    velocity = np.array([1.9, 0.6])
    paths = [(12.0, 14.0) + velocity * TIMES[:, None] + offset for offset in offsets]
    frames = np.random.default_rng(22).standard_normal((T, 40, 62)).astype(np.float32)
    for frame, at in zip(frames, np.stack(paths, axis=1), strict=True):
        for x, y in at:
            add_streak(frame, x, y, sigma, snr, 0.9 * velocity)
    return tbd.detect(frames, TIMES, exposure_s=0.9, threshold=8.5, max_speed_px_s=2.5,
                      max_acceleration_px_s2=0.1).trajectories, paths


def of_two_sensors(offsets, sigma, snr):
    """Find targets that two sensors see, one of them turned and magnified."""
    turn, rng = np.deg2rad(25), np.random.default_rng(23)
    sensors, paths = [], []
    for zoom, own, stamps in ((1.0, 1.0, TIMES), (0.8, 1.2, TIMES + 0.37)):
        angle = turn if zoom != 1.0 else 0.0
        turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        frames = rng.standard_normal((T, 36, 38))
        truth = [(13.0, 14.0) + stamps[:, None] * (0.5, 0.2) + offset for offset in offsets]
        paths.append(truth)
        for frame, at in zip(frames, np.stack(truth, axis=1), strict=True):
            for x, y in at @ turned.T / zoom + (2.0, 6.0):
                add_target(frame, x, y, sigma * own, snr)
        back = zoom * turned.T
        affine = np.column_stack([back, -back @ (2.0, 6.0)])
        sensors.append(tbd.Sensor(frames, stamps, affine, own))
    order = np.argsort(np.concatenate([TIMES, TIMES + 0.37]), kind='stable')
    found = tbd.detect_sensors(sensors, 'convex', threshold=9, max_speed_px_s=0.8).trajectories
    return found, [np.concatenate(both)[order] for both in zip(*paths, strict=True)]


def of_ambiguous_doppler(offsets, sigma, snr):
    """Find targets faster than the columns can tell."""
    rate = 0.15
    maps = np.random.default_rng(24).standard_normal((T, 130, 24)).astype(np.float32)
    paths = []
    for offset in offsets:
        columns = 32.3 + 0.02 * TIMES + offset[0]
        rows = 30.0 + offset[1] + np.append(0, np.cumsum(
            0.5 * rate * (columns[1:] + columns[:-1] - 24)))
        paths.append(np.stack([columns % 24, rows], axis=1))
        for frame, (x, y) in zip(maps, paths[-1], strict=True):
            for turn in (-24, 0, 24):
                add_target(frame, x + turn, y, sigma, snr)
    return tbd.detect(maps, TIMES, motion_model='range_doppler', doppler_ambiguities=1,
                      range_bins_per_doppler_bin=rate, threshold=8.5).trajectories, paths


def across_the_seam(offsets, sigma, snr):
    """Find targets that leave the last column for the first."""
    paths = [LINE + (19.0, 0.0) + offset for offset in offsets]
    frames = scene([(path + (turn, 0.0), snr, sigma) for path in paths for turn in (-40, 0)], 25,
                   (36, 40))
    found = tbd.detect(frames, TIMES, motion_model='range_bearing', threshold=8.5,
                       max_speed_px_s=0.8).trajectories
    for one in found:
        one.positions[:, 0] = np.unwrap(one.positions[:, 0], period=40)
    return found, paths


COMBINATIONS = [
    entering, smeared, of_two_sensors, of_ambiguous_doppler, across_the_seam,
    functools.partial(entering, amplitudes='signed'),
    functools.partial(entering, amplitude_model='constant'),
]
NAMES = [getattr(one, '__name__', str(getattr(one, 'keywords', ''))) for one in COMBINATIONS]


@pytest.mark.parametrize('found_among', COMBINATIONS, ids=NAMES)
def test_wide_target_is_one_trajectory_whatever_else_is_asked(found_among):
    [found], [path] = found_among([np.zeros(2)], 1.6, 15.0)
    np.testing.assert_array_equal(np.isfinite(found.positions), np.isfinite(path))
    assert np.nanmean(np.hypot(*(found.positions - path).T)) < 0.35


@pytest.mark.parametrize('found_among', COMBINATIONS, ids=NAMES)
def test_two_targets_stay_two_whatever_else_is_asked(found_among):
    found, paths = found_among([np.zeros(2), np.array([2.4, 3.2])], 1.0, 12.0)
    assert len(found) == 2
    for path in paths:
        assert min(np.nanmean(np.hypot(*(one.positions - path).T)) for one in found) < 0.35


def test_history_ends_with_the_state_that_is_returned():
    frames = scene([(LINE, 15.0, 1.5)], 26)
    options = DetectorOptions(threshold=8.0, max_speed_px_s=0.8, motion_model='constant_velocity')
    result = ConvexDetector(options).detect(FrameBatch.of(frames, TIMES))
    [found] = result.found
    alone = WorkingSet(frames, np.zeros((0, 0, 0)), GaussianPsf(1.0), 8.0, NonNegative())
    alone.assign(np.array([alone.add(found.positions, 0.0)]), found.amplitudes[None])
    assert result.history[-1].n_paths == 1
    assert result.history[-1].objective == pytest.approx(alone.objective(0.0), rel=1e-6)


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


def paths_in(frames):
    paths = WorkingSet(frames, np.zeros((0, 0, 0)), GaussianPsf(1.0), 8.0, NonNegative())
    for shift, amplitude in ((0.0, 8.0), (2.0, 3.0), (4.0, 1.0)):
        paths.assign(np.array([paths.add(LINE + shift, 0.0)]), np.full((1, T), amplitude))
    return paths


def test_frames_without_some_paths_are_shown_and_cannot_be_changed():
    paths = paths_in(scene([(LINE, 9.0, 1.0)], 10))
    before = paths.residual.copy()
    left = paths.residual_statistic(1)
    with paths.without(0, 2) as shown:
        np.testing.assert_allclose(paths.residual_statistic(1), paths.matched[1] - 3.0, atol=1e-4)
        np.testing.assert_array_equal(shown, paths.residual)
        with pytest.raises(ValueError, match='read-only'):
            shown[0, 0, 0] = 1.0
    np.testing.assert_allclose(paths.residual, before, atol=1e-5)
    np.testing.assert_allclose(left, paths.seen(1) - 3.0, atol=1e-4)


def test_a_source_explains_the_frames_beside_the_paths_for_a_while():
    frames = scene([(LINE, 9.0, 1.0), (LINE + 6.0, 12.0, 1.5)], 11)
    paths = paths_in(frames)
    before = paths.residual.copy()
    model = NonNegative()
    renderer = StampRenderer(GaussianPsf(1.5), frames.shape, np.zeros((0, 0, 0), np.float32))
    stamps = renderer.render(LINE + 6.0)
    source = Source(stamps, model.envelope(stamps.norms), np.zeros(T))
    with paths.beside([source]):
        paths.fit_source(source)
        assert abs(source.amplitudes.mean() - 12.0) < 1.0
        explained = paths.residual.copy()
        paths.refresh()
        np.testing.assert_allclose(paths.residual, explained, atol=1e-5)
    assert np.sum(before**2) - np.sum(explained**2) > 100 * T
    np.testing.assert_allclose(paths.residual, before, atol=1e-5)


def test_ids_of_paths_stay_when_others_leave():
    paths = paths_in(scene([(LINE, 9.0, 1.0)], 12))
    first, second, third = paths.ids
    paths.remove(np.array([0]))
    assert paths.ids == [second, third]
    paths.move(0, LINE + 1.0, 0.0)
    paths.add(LINE, 0.0)
    assert paths.ids[:2] == [second, third] and paths.ids[2] not in (first, second, third)
