"""Targets that move while the shutter is open are searched, fitted and simulated as streaks."""

import itertools

import numpy as np
import pytest

import naive
import track_before_detect as tbd
from track_before_detect.kernels.amplitude_codes import COMPLEX, NON_NEGATIVE, SIGNED
from track_before_detect.kernels.psf.measurement import render_path
from track_before_detect.kernels.scores.streak_scores import scores_of_streak
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.models.measurement.streak import StreakPsf, streaks_of
from track_before_detect.models.measurement.streak_scores import StreakScores
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.simulation.sensor import add_streak
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.path_search import path_search
from track_before_detect.solvers.search.viterbi_table import RowThreads, ViterbiTable
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch

T, SHAPE = 6, (32, 64)
STAMPS = np.arange(float(T))
EXPOSURE = 0.85
VELOCITY = np.array([7.0, 1.3])
OPTIONS = {'max_speed_px_s': 8.0, 'max_acceleration_px_s2': 0.5}
Y, X = np.mgrid[-4:5, -4:5]
PSFS = {'gaussian': GaussianPsf(1.0), 'integrated': GaussianPsf(0.8, integrated=True),
        'array': ArrayPsf(np.exp(-((X + Y)**2 / 2.6**2 + (X - Y)**2 / 1.7**2) / 2))}


def streak_picture(psf, position, streak, shape):
    """Return the unit-norm mean of many pictures along a streak, cut to a frame."""
    nodes = (np.arange(80) + 0.5) / 80 - 0.5
    whole = np.mean([naive.psf_picture(psf, position + node * streak) for node in nodes], axis=0)
    return naive.cut(whole, shape) / np.linalg.norm(naive.cut(whole, shape))


def rendered(psf, positions, shape, weights):
    size = 2 * psf.half_width + 1
    stamps = np.empty((len(positions), size, size))
    origins, norms = np.empty((len(positions), 2), np.int64), np.empty(len(positions))
    render_path(psf.compiled(), positions, *shape, weights, stamps, origins, norms)
    frames = np.zeros((len(positions), *shape))
    for frame, stamp, (x, y) in zip(frames, stamps, origins, strict=True):
        for i, k in np.ndindex(stamp.shape):
            if 0 <= y + i < shape[0] and 0 <= x + k < shape[1]:
                frame[y + i, x + k] = stamp[i, k]
            else:
                assert stamp[i, k] == 0
    return frames


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('velocity', [(6.0, 0.0), (-2.3, 3.1), (0.0, 0.4), (0.0, 0.0)])
def test_stamp_is_the_mean_over_the_exposure_of_unit_norm(name, velocity):
    times = np.array([0.0, 1, 2, 4])
    start = np.where(np.array(velocity) >= 0, 2.3, 26.4)
    positions = start + times[:, None] * velocity
    psf = StreakPsf(PSFS[name], 0.9, 0.9 * np.hypot(*velocity) + 1e-9, tuple(times))
    frames = rendered(psf, positions, (30, 32), np.zeros((0, 0, 0), np.float32))
    np.testing.assert_allclose(np.linalg.norm(frames, axis=(1, 2)), 1, rtol=1e-6)
    for frame, position in zip(frames, positions, strict=True):
        expected = streak_picture(PSFS[name], position, 0.9 * np.array(velocity), (30, 32))
        np.testing.assert_allclose(frame, expected, atol=3e-3)


@pytest.mark.parametrize('code', [NON_NEGATIVE, SIGNED, COMPLEX])
def test_scores_of_a_streak_equal_those_of_a_slow_twin(code):
    generator = np.random.default_rng(1)
    real, imaginary, other = generator.standard_normal((3, 9, 14)).astype(np.float32)
    shares = generator.uniform(0, 1, (9, 14)).astype(np.float32)
    offsets = np.array([[-2, 1], [-1, 0], [0, 0], [1, 0], [2, -1]])
    factors = generator.uniform(0.5, 1, (2, 2)).astype(np.float32)
    imaginary = imaginary if code == COMPLEX else np.empty((0, 0), np.float32)
    left = np.empty((9, 14), np.float32)
    scores_of_streak(other, left, real, imaginary, shares, offsets, factors, False, code, 1.0,
                     0.0, 0, 9)
    for y, x in np.ndindex(9, 14):
        inside = [(y + dy, x + dx) for dx, dy in offsets if 0 <= y + dy < 9 and 0 <= x + dx < 14]
        share = sum(shares[at] for at in inside) / len(offsets)
        assert left[y, x] == pytest.approx(share, rel=1e-5)
        h = sum(real[at] for at in inside) * factors[y % 2, x % 2]
        value = max(h, 0)**2 if code == NON_NEGATIVE else h**2
        if code == COMPLEX:
            value += (sum(imaginary[at] for at in inside) * factors[y % 2, x % 2])**2
        assert other[y, x] == pytest.approx(value / share if share > 1e-3 else 0, rel=1e-4)


@pytest.mark.parametrize('name', PSFS)
def test_scores_of_the_search_are_near_to_the_statistic_of_the_streak(name):
    psf = StreakPsf(PSFS[name], 1.0, 6.0, (0.0, 1.0))
    streaks = np.array([[0.0, 0], [5.0, 2.0], [-2.0, 4.0]])
    scores = StreakScores(psf, (24, 26), AMPLITUDE_MODELS[SIGNED], RowThreads(47, 1), streaks,
                          np.arange(3))
    position = np.array([12.5, 11.0])
    for number, streak in enumerate(streaks):
        frame = 10 * streak_picture(PSFS[name], position, streak, (24, 26)).astype(np.float32)
        found = scores.scores(frame[None])
        assert found.shape == (3, 47, 51)
        assert np.unravel_index(np.argmax(found), found.shape) == (number, 22, 25)
        assert found[number, 22, 25] == pytest.approx(100, rel=0.02)
    # Of unit variance in noise; beside the border, where the norm is guessed, of no more.
    noise = np.random.default_rng(2).standard_normal((400, 24, 26)).astype(np.float32)
    spread = scores.scores(noise).reshape(3, 400, 47, 51).mean(axis=1)
    assert 0.75 < spread[:, 14:-14, 14:-14].min() and spread.max() < 1.4


@pytest.mark.parametrize('acceleration', [0.0, 0.6])
def test_best_path_with_scores_for_each_velocity_is_that_of_all(acceleration):
    graph = build_state_graph(np.arange(4.0), step_px=1.0, max_speed=2.0,
                              max_acceleration=acceleration, turn_cost=0.4)
    streaks, kind = streaks_of(graph, StreakPsf(GaussianPsf(0.7), 1.0, 2.0, (0.0, 1, 2, 3)))
    assert 1 < len(streaks) < graph.n_velocities
    generator = np.random.default_rng(3)
    table = ViterbiTable(graph, (5, 6), kinds=kind)
    for _ in range(2):
        scores = generator.exponential(size=(len(streaks) * 4, 5, 6)).astype(np.float32)
        best = -np.inf
        for chosen in itertools.product(range(graph.n_velocities), repeat=graph.n_segments):
            turns = np.abs(np.diff(graph.grid[list(chosen)], axis=0))
            if turns.size and turns.max() > graph.reach:
                continue
            for y, x in np.ndindex(5, 6):
                start, value = np.array([x, y]), -0.4 * turns.sum()
                for j, velocity in enumerate(chosen):
                    for t in range(graph.knots[j], graph.knots[j + 1]):
                        at = start + graph.moves[t, velocity]
                        inside = (at >= 0).all() and (at < (6, 5)).all()
                        value += (scores[4 * kind[velocity] + t, at[1], at[0]] if inside
                                  else -np.inf)
                    start = start + graph.end_moves[j, velocity]
                best = max(best, value)
        assert table.update(scores, 0.0) == pytest.approx(best, rel=1e-5)
        [path] = table.best_paths(0.0, 1, 1)
        x, y = path.positions.astype(int).T
        met = scores[4 * kind[path.velocities] + np.arange(4), y, x].sum()
        assert met - path.turn_cost == pytest.approx(best, rel=1e-5)


def test_opposite_velocities_leave_one_streak():
    graph = build_state_graph(STAMPS, step_px=0.5, max_speed=8.0, max_acceleration=0.5,
                              turn_cost=3.0)
    psf = StreakPsf(GaussianPsf(1.0), EXPOSURE, 7.0, tuple(STAMPS))
    streaks, kind = streaks_of(graph, psf)
    for velocity, number in zip(graph.velocities, kind, strict=True):
        [opposite] = np.flatnonzero(np.abs(graph.velocities + velocity).max(axis=1) < 1e-9)
        assert kind[opposite] == number
        apart = min(np.abs(streaks[number] - sign * EXPOSURE * velocity).max()
                    for sign in (1, -1))
        assert apart <= 1.0 + 1e-9


def scene(snr, path, velocity, exposure=EXPOSURE, shape=SHAPE):
    frames = np.zeros((len(path), *shape))
    for frame, (x, y) in zip(frames, path, strict=True):
        add_streak(frame, x, y, 1.0, snr, exposure * velocity)
    return frames


@pytest.mark.parametrize('detector', ['convex', 'greedy'])
@pytest.mark.parametrize('amplitudes', ['non-negative', 'signed', 'complex'])
def test_noise_free_streak_is_recovered(detector, amplitudes):
    path = np.array([12.2, 12.3]) + VELOCITY * STAMPS[:, None]
    factor = {'non-negative': 1, 'signed': -1, 'complex': 1j}[amplitudes]
    found = tbd.detect(30 * factor * scene(1.0, path, VELOCITY), threshold=9.0,
                       exposure_s=EXPOSURE, amplitudes=amplitudes, detector=detector, **OPTIONS)
    best = found.trajectories[0]
    if detector == 'greedy':
        assert np.abs(best.positions - path).max() < 1.0
        return
    assert len(found.trajectories) == 1
    np.testing.assert_allclose(best.positions, path, atol=0.02)
    np.testing.assert_allclose(best.velocity, np.tile(VELOCITY, (T, 1)), atol=0.02)
    np.testing.assert_allclose(best.amplitudes, 30 * factor, rtol=2e-3)


def test_masked_streak_is_recovered():
    path = np.array([12.2, 12.3]) + VELOCITY * STAMPS[:, None]
    mask = np.random.default_rng(4).random((T, *SHAPE)) < 0.2
    frames = np.where(mask, np.nan, scene(30.0, path, VELOCITY))
    [found] = tbd.detect(frames, threshold=9.0, exposure_s=EXPOSURE, **OPTIONS).trajectories
    np.testing.assert_allclose(found.positions, path, atol=0.05)
    np.testing.assert_allclose(found.amplitudes, 30, rtol=1e-2)


def test_estimates_of_a_streak_are_unbiased():
    generator = np.random.default_rng(5)
    pipeline = TrackingPipeline(DetectorOptions(threshold=9.0, exposure_s=EXPOSURE, **OPTIONS))
    errors, speeds, amplitudes = [], [], []
    for _ in range(15):
        path = generator.uniform((10, 10), (14, 14)) + VELOCITY * STAMPS[:, None]
        frames = scene(9.0, path, VELOCITY) + generator.standard_normal((T, *SHAPE))
        pipeline.reset()
        [found] = pipeline.process(FrameBatch.of(frames, STAMPS)).trajectories
        errors.append((found.positions - path).mean(axis=0))
        speeds.append(found.velocity.mean(axis=0) - VELOCITY)
        amplitudes.append(found.amplitudes.mean() / 9)
    for values, size in ((errors, 0.5), (speeds, 0.3), (np.subtract(amplitudes, 1), 0.2)):
        values = np.array(values)
        assert np.abs(values).max() < size
        # Four standard errors of the mean, and what is left of the grid.
        assert (np.abs(values.mean(axis=0))
                < 4 * values.std(axis=0) / np.sqrt(len(values)) + 0.01).all()


def test_dim_streak_stands_out_more_when_it_is_searched_as_one():
    # Without exposure 0.82 of the statistic is left of a streak of six standard deviations.
    generator = np.random.default_rng(6)
    searches = []
    for exposure in (EXPOSURE, 0.0):
        detector = ConvexDetector(DetectorOptions(threshold=9.0, exposure_s=exposure, **OPTIONS))
        psf = detector.measurement
        if exposure:
            psf = StreakPsf(psf, EXPOSURE, EXPOSURE * 8.0, tuple(STAMPS))
        searches.append(path_search(detector.graph(STAMPS, SHAPE), psf, SHAPE, detector.model))
    noise = generator.standard_normal((12, T, *SHAPE)).astype(np.float32)
    path = np.array([12.2, 12.3]) + VELOCITY * STAMPS[:, None]
    target = scene(4.0, path, VELOCITY).astype(np.float32)
    in_noise, with_target = (np.array([[np.sqrt(search.best_value(frames)) for frames in stack]
                                       for search in searches])
                             for stack in (noise, noise + target))
    above = (with_target - np.mean(in_noise, axis=1, keepdims=True)).mean(axis=1)
    # 4 sqrt(6) (1 - 0.82) = 1.8 apart, with a standard error of 0.3.
    assert above[0] > above[1] + 0.8


def test_no_exposure_changes_nothing():
    path = np.array([12.2, 12.3]) + 0.5 * STAMPS[:, None]
    frames = np.random.default_rng(7).standard_normal((T, *SHAPE)) + scene(
        8.0, path, np.zeros(2))
    [plain] = tbd.detect(frames, threshold=8.0).trajectories
    [zero] = tbd.detect(frames, threshold=8.0, exposure_s=0.0).trajectories
    np.testing.assert_array_equal(plain.positions, zero.positions)
    # A target at rest leaves no streak.
    [still] = tbd.detect(frames, threshold=8.0, exposure_s=1.0, motion_model='static',
                         max_speed_px_s=0.0).trajectories[:1]
    [moment] = tbd.detect(frames, threshold=8.0, motion_model='static').trajectories[:1]
    np.testing.assert_allclose(still.positions, moment.positions, atol=1e-9)


def test_simulated_streaks_have_the_given_amplitude_and_length():
    overrides = {'speed_px_per_frame': 6.0, 'n_frames': 6, 'n_targets': 1, 'snr': 0.0}
    noise = simulate('single_target', 3, **overrides).frames
    overrides['snr'] = 50.0
    moments = simulate('single_target', 3, **overrides)
    streaks = simulate('single_target', 3, exposure_s=0.04, **overrides)
    np.testing.assert_array_equal(streaks.truth, moments.truth)
    path = streaks.truth[:, 2:]
    step = np.hypot(*np.diff(path, axis=0).T).mean()
    spreads = []
    for recording in (moments, streaks):
        picture = recording.frames[2] - noise[2]
        assert np.linalg.norm(picture) == pytest.approx(50, rel=1e-3)
        y, x = np.indices(picture.shape)
        spreads.append(np.sum(picture * ((x - path[2, 0])**2 + (y - path[2, 1])**2))
                       / picture.sum())
    assert spreads[1] - spreads[0] == pytest.approx(step**2 / 12, rel=0.02)


@pytest.mark.parametrize(('options', 'words'), [
    ({'exposure_s': 1.5}, 'median interval'), ({'detector': 'mt_dp'}, 'mt_dp'),
    ({'motion_model': 'range_bearing'}, 'motion_model'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0}, 'motion_model'),
    ({'registration': 'translation'}, 'registration'),
    ({'amplitude_model': 'constant'}, 'amplitude_model'),
    ({'continuation': [1.0]}, 'continuation'), ({'exposure_s': -1.0}, 'at least 0')])
def test_what_streaks_cannot_be_combined_with_is_refused_in_one_sentence(options, words):
    with pytest.raises(tbd.ParameterError, match=words) as error:
        tbd.detect(np.zeros((T, *SHAPE)), threshold=8.0, **{'exposure_s': 0.5, **options})
    assert len(str(error.value).splitlines()) == 1
