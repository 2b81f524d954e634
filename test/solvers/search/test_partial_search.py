"""Targets that enter or leave during the batch: found, and not invented where they are not."""

import itertools

import numpy as np
import pytest

from enumeration import best_in_any_frames
from false_alarms import assert_rate_is_realised
import track_before_detect as tbd
from track_before_detect.kernels.amplitude_codes import (
    COMPLEX,
    CONSTANT,
    NON_NEGATIVE,
    SIGNED,
    SIGNED_CONSTANT,
)
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.models.presence import frames_seen_in, Presence, presence_for
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.path_search import path_search
from track_before_detect.solvers.search.viterbi_table import RowThreads
from track_before_detect.types import FrameBatch

PRESENCE = Presence(0.9, 1.5, 2.5)
OF_CONSTANT = Presence(0.0, 0.2, 0.4)


@pytest.mark.parametrize(('n_frames', 'acceleration', 'seed'), [
    (4, 0.0, 1), (4, 0.2, 2), (4, 3.0, 3), (5, 0.3, 4), (1, 0.0, 5)])
@pytest.mark.parametrize('code', [NON_NEGATIVE, SIGNED, COMPLEX])
def test_best_path_equals_search_through_every_path_and_interval(n_frames, acceleration, seed,
                                                                 code):
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1.0, max_speed=0.7,
                              max_acceleration=acceleration, turn_cost=0.8)
    psf, model = GaussianPsf(2.0), AMPLITUDE_MODELS[code]
    search = path_search(graph, psf, (4, 5), model, PRESENCE)
    frames = noise_frames(np.random.default_rng(seed), (n_frames, 4, 5), code == COMPLEX)
    # Something in a few frames only, so that the best path is there in a part of them.
    frames[n_frames // 2:n_frames // 2 + 2, 1:3, 2:4] += 1.5j if code == COMPLEX else 1.5
    scores = psf.scores(graph, (4, 5), model, RowThreads(4, 1)).scores(frames)
    expected, positions = best_in_any_frames(graph, scores, PRESENCE)
    largest, [found] = search.best_paths(frames, -1e9, 1.0, 1)
    assert largest == pytest.approx(expected, rel=1e-5)
    assert found.value == pytest.approx(expected, rel=1e-5)
    np.testing.assert_array_equal(found.positions, positions)
    met = [scores[t, int(y), int(x)]
           for t, (x, y) in enumerate(found.positions) if np.isfinite(x)]
    assert sum(met) - found.cost == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(('n_frames', 'acceleration', 'seed'), [
    (4, 0.0, 1), (4, 0.2, 2), (5, 0.3, 4), (1, 0.0, 5)])
@pytest.mark.parametrize('weighted', [False, True])
@pytest.mark.parametrize('code', [CONSTANT, SIGNED_CONSTANT])
def test_best_path_of_constant_amplitude_equals_search_through_all(n_frames, acceleration, seed,
                                                                   code, weighted):
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1.0, max_speed=0.7,
                              max_acceleration=acceleration, turn_cost=0.1)
    shape = (4, 5)
    psf, model = GaussianPsf(2.0), AMPLITUDE_MODELS[code]
    search = path_search(graph, psf, shape, model, OF_CONSTANT)
    generator = np.random.default_rng(seed)
    frames = generator.standard_normal((n_frames, *shape), dtype=np.float32)
    frames[n_frames // 2:n_frames // 2 + 2, 1:3, 2:4] += 1.5 if code == CONSTANT else -1.5
    squares = np.ones((n_frames, *shape))
    scores = psf.scores(graph, shape, model, RowThreads(4, 1))
    if weighted:
        weights = generator.uniform(0.4, 1.5, frames.shape).astype(np.float32)
        search.set_weights(weights)
        scores.set_weights(weights)
        squares = scores.squares
    products = scores.scores(frames, 1.0)
    expected, positions = max(
        (best_in_any_frames(graph, sign * products, OF_CONSTANT, squares)
         for sign in ((1,) if code == CONSTANT else (1, -1))), key=lambda one: one[0])
    for above in (-np.inf, 0.0, 0.9 * expected):
        largest, [found] = search.best_paths(frames, above, 1.0, 1)
        assert largest == pytest.approx(expected, rel=1e-5)
        assert found.value == pytest.approx(expected, rel=1e-5)
        np.testing.assert_array_equal(found.positions, positions)
    assert search.best_value(frames) == pytest.approx(expected, rel=1e-5)
    largest, none = search.best_paths(frames, 1.01 * expected, 1.0, 1)
    assert not none and largest == 1.01 * expected


def test_search_of_the_same_frames_again_and_of_others_is_that_of_a_new_one():
    graph = build_state_graph(np.arange(6.0), step_px=1.0, max_speed=1.0, max_acceleration=0.2,
                              turn_cost=0.8)

    def new_search():
        return path_search(graph, GaussianPsf(2.0), (12, 9), AMPLITUDE_MODELS[SIGNED], PRESENCE)

    search, generator = new_search(), np.random.default_rng(4)
    first, other = generator.standard_normal((2, 6, 12, 9)).astype(np.float32)
    for frames in (first, first, other, first):
        again, fresh = (made.best_paths(frames, 0.0, 2.0, 3)
                        for made in (search, new_search()))
        assert again[0] == fresh[0]
        for a, b in zip(again[1], fresh[1], strict=True):
            assert a.value == b.value
            np.testing.assert_array_equal(a.positions, b.positions)


@pytest.mark.parametrize('amplitude_model', ['fluctuating', 'constant'])
def test_batch_with_weights_and_one_without_do_not_change_each_other(amplitude_model):
    rng = np.random.default_rng(17)
    options = DetectorOptions(presence='partial', amplitude_model=amplitude_model, threshold=5.0,
                              max_speed_px_s=0.5)
    batches = []
    for weighted in (False, True, False, True):
        frames = rng.standard_normal((8, 20, 24)).astype(np.float32)
        for frame in frames[3:]:
            add_target(frame, 11.3, 8.6, 1.0, 5.0)
        weights = rng.uniform(0.5, 1.0, (8, 20, 24)).astype(np.float32)
        weights[:, :, :4] = 0
        batches.append((FrameBatch.of(frames * weights if weighted else frames, np.arange(8.0)),
                        weights if weighted else None))
    detector = ConvexDetector(options)
    for batch in batches:
        again = detector.detect(*batch).found
        alone = ConvexDetector(options).detect(*batch).found
        assert len(again) == len(alone) > 0
        for one, other in zip(again, alone, strict=True):
            np.testing.assert_array_equal(one.positions, other.positions)
            assert one.statistic == other.statistic


@pytest.mark.parametrize('seed', range(5))
def test_best_interval_is_the_best_of_all(seed):
    gains = np.random.default_rng(seed).exponential(1.0, 12)
    values = {(first, last): gains[first:last + 1].sum() - PRESENCE.cost(first, last, 12)
              for first, last in itertools.combinations_with_replacement(range(12), 2)}
    assert PRESENCE.best_interval(gains) == max(values, key=values.get)


@pytest.mark.parametrize('seed', range(5))
def test_best_interval_of_a_constant_amplitude_is_the_best_of_all(seed):
    generator = np.random.default_rng(seed)
    products, squares = generator.normal(0.5, 1.0, 12), generator.uniform(0.2, 1.0, 12)
    products[3], squares[3] = -np.inf, 0.0
    values = {
        (first, last): (products[first:last + 1].sum()
                        - 12**0.5 * OF_CONSTANT.cost(first, last, 12))
        / max(squares[first:last + 1].sum(), 1e-9)**0.5
        for first, last in itertools.combinations_with_replacement(range(12), 2)}
    assert OF_CONSTANT.best_constant_interval(products, squares) == max(values, key=values.get)


def test_frames_without_the_target_are_cut_off_and_weak_ones_inside_are_not():
    seen = np.array([0.1, -0.6, 0.4, 3.1, 2.7, 0.2, 3.5, 2.9, 0.3, -0.2])
    assert frames_seen_in(seen) == (3, 7)
    assert frames_seen_in(np.full(6, 2.0)) == (0, 5)
    assert frames_seen_in(np.zeros(4)) == (0, 3)


def scene(seed, first, last, snr, n_frames=20, size=64, amplitudes='non-negative'):
    """Return noise with a target that is there from ``first`` to ``last``, and its positions."""
    generator = np.random.default_rng(seed)
    frames = noise_frames(generator, (n_frames, size, size), amplitudes == 'complex')
    angle = generator.uniform(0, 2 * np.pi)
    velocity = generator.uniform(0.2, 1.0) * np.array([np.cos(angle), np.sin(angle)])
    middle = generator.uniform(18, size - 19, 2)
    positions = middle + (np.arange(n_frames)[:, None] - n_frames / 2) * velocity
    signs = {'signed': generator.choice((-1, 1), n_frames),
             'complex': np.exp(2j * np.pi * generator.random(n_frames))}.get(
                 amplitudes, np.ones(n_frames))
    for t in range(first, last + 1):
        target = np.zeros((size, size))
        add_target(target, *positions[t], 1.0, snr)
        frames[t] += (signs[t] * target).astype(frames.dtype)
    return frames, positions


@pytest.mark.parametrize(('amplitudes', 'model', 'threshold'), [
    ('non-negative', 'fluctuating', 9), ('signed', 'fluctuating', 9),
    ('complex', 'fluctuating', 9), ('non-negative', 'constant', 7)])
@pytest.mark.parametrize(('first', 'last'), [(8, 19), (0, 12), (5, 13), (0, 19)])
def test_target_that_enters_or_leaves_is_found_in_its_frames(first, last, amplitudes, model,
                                                             threshold):
    errors = []
    for seed in range(6):
        frames, positions = scene(seed, first, last, 5.0, amplitudes=amplitudes)
        result = tbd.detect(frames, threshold=threshold, presence='partial',
                            amplitudes=amplitudes, amplitude_model=model)
        assert len(result.trajectories) == 1
        [trajectory] = result.trajectories
        [present] = np.nonzero(np.isfinite(trajectory.positions[:, 0]))
        np.testing.assert_array_equal(np.isfinite(trajectory.amplitudes),
                                      np.isfinite(trajectory.positions[:, 0]))
        np.testing.assert_array_equal(np.isfinite(trajectory.velocity),
                                      np.isfinite(trajectory.positions))
        distance = np.hypot(*(trajectory.positions - positions).T)
        assert np.nanmean(distance[first:last + 1]) < 0.5
        errors.append([abs(present[0] - first), abs(present[-1] - last)])
    # At SNR 5 a frame is told from noise; a neighbouring one passes for the target at times.
    assert np.mean(errors) < 0.5
    assert np.max(errors) <= 3


def test_target_that_leaves_across_the_border_is_followed_to_it():
    frames = np.random.default_rng(2).standard_normal((16, 48, 48), dtype=np.float32)
    positions = np.array([35.0, 20.0]) + np.arange(16)[:, None] * (1.0, 0.2)
    for frame, (x, y) in zip(frames, positions, strict=True):
        add_target(frame, x, y, 1.0, 6.0)
    [trajectory] = tbd.detect(frames, threshold=9, presence='partial').trajectories
    [present] = np.nonzero(np.isfinite(trajectory.positions[:, 0]))
    assert present[0] == 0 and 11 <= present[-1] <= 13


@pytest.mark.parametrize('model', ['fluctuating', 'constant'])
def test_target_that_is_there_all_the_time_is_found_as_before(model):
    made = simulate('single_target', 4, snr=4.0, height=64, width=64)
    full, partial = (tbd.detect(made.frames, threshold=7.5, presence=presence,
                                amplitude_model=model).trajectories
                     for presence in ('full', 'partial'))
    assert len(full) == len(partial) == 1
    np.testing.assert_allclose(partial[0].positions, full[0].positions, atol=1e-6)
    assert partial[0].statistic == pytest.approx(full[0].statistic, rel=1e-6)


@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_trajectories_of_several_batches_are_joined(detector):
    frames, positions = scene(3, 6, 33, 5.0, n_frames=40, size=80)
    result = tbd.detect(frames, threshold=9, presence='partial', batch_length=16,
                        detector=detector)
    trajectory = result.trajectories[0]
    present = np.isfinite(trajectory.positions[:, 0])
    assert not present[:4].any() and present[8:32].all() and not present[36:].any()
    assert np.nanmean(np.hypot(*(trajectory.positions - positions).T)) < 1.0


def test_statistic_of_constant_amplitude_is_that_of_the_frames_with_the_target():
    frames, positions = scene(3, 13, 19, 0.0)
    frames[:] = 0.0
    for frame, (x, y) in zip(frames[13:], positions[13:], strict=True):
        add_target(frame, x, y, 1.0, 8.0)
    [partial] = tbd.detect(frames, amplitude_model='constant', presence='partial',
                           threshold=7).trajectories
    # Entering costs more where a target shows in few frames.
    entry = presence_for(AMPLITUDE_MODELS[CONSTANT]).entry
    assert partial.statistic == pytest.approx(
        8 * np.sqrt(7) - entry * np.sqrt(20 / 7), abs=0.02)
    np.testing.assert_array_equal(np.isfinite(partial.positions[:, 0]), np.arange(20) >= 13)
    np.testing.assert_allclose(partial.amplitudes[13:], 8.0, rtol=0.01)


def test_range_doppler_target_may_leave():
    made = simulate('range_doppler', 2, snr=6.0)
    frames = made.frames.copy()
    frames[9:] = np.random.default_rng(1).standard_normal(frames[9:].shape)
    [trajectory] = tbd.detect(
        frames, made.stamps, motion_model='range_doppler', presence='partial', threshold=8,
        range_bins_per_doppler_bin=0.3).trajectories
    present = np.isfinite(trajectory.positions[:, 0])
    assert present[:8].all() and not present[11:].any()
    error = trajectory.positions - made.truth[:, 2:]
    assert np.nanmax(np.abs(error[:9])) < 1.0


@pytest.mark.parametrize(('amplitudes', 'model'), [
    ('non-negative', 'fluctuating'), ('signed', 'fluctuating'), ('complex', 'fluctuating'),
    ('non-negative', 'constant')])
def test_realised_rate_in_noise_is_the_requested_one(amplitudes, model, calibrate_on):
    calibrate_on(400)
    n_runs, rate, shape = 200, 0.3, (40, 40)
    detector = ConvexDetector(DetectorOptions(
        psf_sigma_px=2.0, presence='partial', amplitudes=amplitudes, amplitude_model=model,
        false_alarm_rate=rate))
    stamps = np.arange(8.0)
    bound = detector.threshold(stamps, shape)
    search = detector.noise_study(stamps, shape).searcher(shape)
    assert_rate_is_realised(lambda generator: search(generator) > bound, rate, n_runs, 12)


def test_combinations_that_cannot_be_are_refused():
    with pytest.raises(tbd.ParameterError, match='threshold must be above 5.29 .* 20 frames'):
        tbd.detect(np.zeros((20, 16, 16)), presence='partial', threshold=5)
