"""Over range-Doppler maps the column of a target moves its row, and nothing else does."""

import numpy as np
import pytest

from false_alarms import assert_rate_is_realised
import naive
import track_before_detect as tbd
from track_before_detect.kernels.amplitude_codes import NON_NEGATIVE
from track_before_detect.kernels.rows import ABSENT
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.base import Scores
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.range_doppler import build_range_doppler_graph
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.calibration import threshold
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.path_search import path_search
from track_before_detect.solvers.search.sheared_scores import ShearedScores

STAMPS = {
    'regular': np.arange(6.0),
    'dropped frame': np.array([0.0, 1, 2, 4, 5, 6]),
    'irregular': np.array([0.0, 0.7, 2.1, 3.0, 4.6, 5.2]),
    'single frame': np.zeros(1),
}


class GivenScores(Scores):
    """Scores that are the frames themselves."""

    def __init__(self, grid_shape):
        self.grid_shape = grid_shape

    def set_weights(self, weights):
        """Take no notice."""

    def scores(self, frames, factor=None, tilt=0.0):
        """Return the frames."""
        return frames


def sheared(graph, grid_shape):
    return ShearedScores(GivenScores(grid_shape), graph)


def graph_for(stamps, k=0.6, acceleration=0.2, step=0.5, still=4.0):
    return build_range_doppler_graph(
        stamps, step_px=step, rows_per_column=k, still_column=still,
        max_acceleration=acceleration, turn_cost=1.0)


@pytest.mark.parametrize('name', STAMPS)
@pytest.mark.parametrize('k', [0.6, -0.3])
@pytest.mark.parametrize('acceleration', [0.0, 0.05, 0.4])
def test_rows_of_every_path_follow_its_columns(name, k, acceleration):
    stamps = STAMPS[name]
    graph = graph_for(stamps, k, acceleration)
    plane = sheared(graph, (61, 17))
    # Half a step of the column over the time from the middle, the roundings, and the turns.
    half_time = np.ptp(stamps) / 2
    slack = 1.5 + (abs(k) * 0.5 + 1.0) * (half_time + 0.5)
    checked = 0
    for positions, _ in naive.every_path(graph, plane.grid_shape):
        x, y = plane.restore(positions, np.arange(len(positions))).T * graph.step_px
        rate = k * (x - 4.0)
        expected = np.append(0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(stamps)))
        assert np.abs(y - y[0] - expected).max() < slack * graph.step_px
        checked += 1
        if checked > 1500:
            break
    assert checked > 1000


@pytest.mark.parametrize('acceleration', [0.0, 0.1, 1.0])
@pytest.mark.parametrize('k', [0.5, -1.0])
def test_search_finds_the_best_of_all_paths(k, acceleration):
    stamps = np.arange(4.0)
    graph = graph_for(stamps, k, acceleration, step=1.0, still=2.0)
    psf, shape = GaussianPsf(2.0), (7, 5)
    search = path_search(graph, psf, shape, AMPLITUDE_MODELS[NON_NEGATIVE])
    frames = np.random.default_rng(3).standard_normal((4, *shape)).astype(np.float32)
    plain = np.stack([naive.matched_filter(frame, psf)[0] for frame in frames])
    plain = np.maximum(plain, 0)**2
    plane = sheared(graph, shape)
    best = -np.inf
    for positions, cost in naive.every_path(graph, plane.grid_shape):
        x, y = plane.restore(positions, np.arange(len(positions))).astype(int).T
        if (y >= 0).all() and (y < shape[0]).all():
            best = max(best, plain[range(4), y, x].sum() - cost)
    value, [found, *_] = search.best_paths(frames, 0.0, 1.0, 1)
    assert value == pytest.approx(best, rel=1e-4)
    x, y = found.positions.astype(int).T
    assert plain[range(4), y, x].sum() - found.cost == pytest.approx(best, rel=1e-4)


def test_rows_outside_a_map_cannot_be_visited():
    graph = graph_for(np.arange(3.0), k=1.0, acceleration=0.0, step=1.0, still=2.0)
    seen = sheared(graph, (4, 5)).scores(np.ones((3, 4, 5), np.float32))
    assert (seen[0, :2, 0] == 1).all() and (seen[0, 2:, 4] == 1).all()
    assert (seen[0, 2:, 0] == ABSENT).all() and (seen[0, :2, 4] == ABSENT).all()
    np.testing.assert_array_equal(seen[1], 1)


@pytest.mark.parametrize(('k', 'offset', 'interval'), [(0.3, 0, 1.0), (-0.8, 3, 0.5)])
def test_target_without_noise_is_recovered_between_the_bins(k, offset, interval):
    stamps = np.delete(interval * np.arange(13.0), 5)
    column = 20 + offset + 7.3 + 0.02 * (stamps - stamps.mean()) / interval
    rows = 100.2 + np.append(0, np.cumsum(
        k * (0.5 * (column[1:] + column[:-1]) - 20 - offset) * np.diff(stamps)))
    frames = np.stack([30 * naive.gaussian_stamp((180, 40), (x, y), 1.0, 4)
                       for x, y in zip(column, rows, strict=True)])
    result = tbd.detect(frames, stamps, motion_model='range_doppler', threshold=8,
                        range_bins_per_doppler_bin=k, doppler_offset_bins=offset)
    [trajectory] = result.trajectories
    np.testing.assert_allclose(trajectory.positions, np.stack([column, rows], 1), atol=0.02)


@pytest.mark.parametrize(('detector', 'most'), [('convex', 0.05), ('greedy', 1.25)])
def test_irregular_intervals_move_a_target_by_as_much_as_they_last(detector, most):
    generator = np.random.default_rng(8)
    for _ in range(3):
        # Greedy stays on half bins: a quarter of one in Doppler over 7.5 s, and roundings.
        # Dwells that are late or early by up to 0.3 s, and some that are missing.
        stamps = np.delete(np.arange(16.0) + generator.uniform(-0.3, 0.3, 16),
                           generator.choice(np.arange(1, 15), 3, replace=False))
        k, column = 0.4, 20 + generator.choice((-1, 1)) * generator.uniform(12, 16)
        rows = 128 + k * (column - 20) * (stamps - stamps.mean())
        frames = np.stack([30 * naive.gaussian_stamp((256, 40), (column, y), 1.0, 4)
                           for y in rows])
        [trajectory, *_] = tbd.detect(frames, stamps, motion_model='range_doppler', threshold=8,
                                      detector=detector,
                                      range_bins_per_doppler_bin=k).trajectories
        np.testing.assert_allclose(trajectory.positions[:, 1], rows, atol=most)
        np.testing.assert_allclose(trajectory.velocity[:, 1], k * (column - 20), atol=2 * most)


def test_target_that_moves_against_its_doppler_is_not_found():
    made = simulate('range_doppler', 3, snr=4.0, range_bins_per_doppler_bin=-0.3)
    options = {'motion_model': 'range_doppler', 'threshold': 8.0}
    right = tbd.detect(made.frames, made.stamps, range_bins_per_doppler_bin=-0.3, **options)
    wrong = tbd.detect(made.frames, made.stamps, range_bins_per_doppler_bin=0.3, **options)
    assert [len(right.trajectories), len(wrong.trajectories)] == [1, 0]
    truth = made.truth[:, 2:]
    assert np.hypot(*(right.trajectories[0].positions - truth).T).max() < 1.0


@pytest.mark.parametrize('presence', ['full', 'partial'])
@pytest.mark.parametrize('amplitudes', ['non-negative', 'signed', 'complex'])
def test_target_is_found_with_any_amplitudes_and_presence(amplitudes, presence):
    made, empty = (simulate('range_doppler', 5, snr=snr) for snr in (6.0, 0.0))
    target, generator = made.frames - empty.frames, np.random.default_rng(6)
    if amplitudes == 'complex':
        target = target * np.exp(2j * np.pi * generator.random(16))[:, None, None]
    if presence == 'partial':
        target[9:] = 0
    frames = target + noise_frames(generator, target.shape, amplitudes == 'complex')
    [trajectory] = tbd.detect(
        frames, made.stamps, motion_model='range_doppler', range_bins_per_doppler_bin=0.3,
        amplitudes=amplitudes, presence=presence, threshold=8.0).trajectories
    present = np.isfinite(trajectory.positions[:, 0])
    assert present[:7].all()
    assert present[11:].all() if presence == 'full' else not present[11:].any()
    error = np.hypot(*(trajectory.positions - made.truth[:, 2:]).T)
    assert np.nanmean(error) < 0.5


def test_realised_rate_in_noise_is_the_requested_one(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(threshold, 'N_CROPS', 150)
    n_runs, rate, shape = 200, 0.3, (180, 24)
    detector = ConvexDetector(DetectorOptions(
        psf_sigma_px=2.0, motion_model='range_doppler', range_bins_per_doppler_bin=0.5,
        false_alarm_rate=rate))
    stamps = np.arange(8.0)
    bound = detector.threshold(stamps, shape)
    search = path_search(detector.graph(stamps, shape), detector.measurement, shape,
                         detector.model)

    def passes(generator):
        noise = generator.standard_normal((8, *shape), dtype=np.float32)
        return search.best_value(noise) > bound**2

    assert_rate_is_realised(passes, rate, n_runs, 12)


@pytest.mark.parametrize(('options', 'message'), [
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0, 'detector': 'mt_dp'},
     'mt_dp cannot honour motion_model=range_doppler'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0,
      'presence': 'partial', 'amplitude_model': 'constant', 'amplitudes': 'complex'},
     'presence=partial with .*=constant'),
    ({'motion_model': 'range_doppler'}, 'without range_bins_per_doppler_bin'),
    ({'range_bins_per_doppler_bin': 1.0}, '_bin=1 without motion_model=range_doppler'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0, 'max_speed_px_s': 2},
     'max_speed_px_s=2 with motion_model=range_doppler, only automatic'),
])
def test_options_that_contradict_each_other_are_refused(options, message):
    with pytest.raises(tbd.ParameterError, match=message):
        tbd.detect(np.zeros((4, 16, 16)), threshold=8, **options)


def test_search_that_is_too_large_is_refused():
    with pytest.raises(tbd.ParameterError, match='lower max_acceleration_px_s2'):
        tbd.detect(np.zeros((16, 16, 4000)), threshold=8, motion_model='range_doppler',
                   range_bins_per_doppler_bin=1e-5, max_acceleration_px_s2=1e5)


def maps_around(column, k, snr, first_row=60.0, shape=(120, 24)):
    """Return maps without noise of a target whose true Doppler columns (T,) may be off the map."""
    rows = first_row + np.append(0, np.cumsum(0.5 * k * (
        column[1:] + column[:-1] - 2 * (shape[1] // 2))))
    maps = np.zeros((len(column), *shape), np.float32)
    for picture, x, y in zip(maps, column, rows, strict=True):
        for turn in (-1, 0, 1):
            add_target(picture, x % shape[1] + turn * shape[1], y, 1.0, snr)
    return maps, rows


@pytest.mark.parametrize('amplitudes', ['non-negative', 'complex'])
@pytest.mark.parametrize('turns', [-1, 0, 1])
@pytest.mark.parametrize('column', [0.2, 23.7, 8.3])
def test_target_faster_than_the_blind_speed_is_found_once_at_its_true_speed(
        column, turns, amplitudes):
    k = 0.15
    columns = column + 24 * turns + 0.02 * np.arange(10)
    maps, rows = maps_around(columns, k, 20.0)
    phases = np.exp(1j * np.arange(10)) if amplitudes == 'complex' else np.ones(10)
    [trajectory] = tbd.detect(
        maps * phases[:, None, None], motion_model='range_doppler', doppler_ambiguities=1,
        range_bins_per_doppler_bin=k, amplitudes=amplitudes, threshold=7.0).trajectories
    x, y = trajectory.positions.T
    np.testing.assert_allclose((x - columns + 12) % 24 - 12, 0, atol=0.05)
    assert (x >= -0.5).all() and (x < 23.5).all()
    np.testing.assert_allclose(y, rows, atol=0.05)
    np.testing.assert_allclose(trajectory.velocity[:, 1], k * (columns - 12), atol=0.05)
    np.testing.assert_allclose(np.abs(trajectory.amplitudes), 20.0, rtol=0.02)


def test_targets_of_one_column_and_different_speeds_are_told_apart():
    k, times = 0.15, np.arange(10.0)
    slow, slow_rows = maps_around(7.0 + 0 * times, k, 6.0, 70.0)
    fast, fast_rows = maps_around(31.0 + 0 * times, k, 6.0, 50.0)
    maps = slow + fast + np.random.default_rng(1).standard_normal(slow.shape)
    found = tbd.detect(maps, motion_model='range_doppler', range_bins_per_doppler_bin=k,
                       doppler_ambiguities=1, threshold=7.5).trajectories
    assert len(found) == 2
    found.sort(key=lambda trajectory: trajectory.velocity[0, 1])
    for trajectory, rows in zip(found, (slow_rows, fast_rows), strict=True):
        assert np.abs(trajectory.positions - np.stack([7 + 0 * times, rows], 1)).mean() < 0.5


@pytest.mark.parametrize('presence', ['full', 'partial'])
@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_simulated_target_beyond_the_blind_speed_is_found(detector, presence):
    overrides = {'height': 128, 'width': 32, 'n_frames': 12, 'range_bins_per_doppler_bin': 0.2,
                 'doppler_ambiguities': 1, 'speed_px_per_frame': 8.0}
    options = {'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 0.2,
               'threshold': 7.5, 'detector': detector, 'presence': presence}
    beyond = 0
    for seed in range(6):
        made = simulate('range_doppler', seed, snr=6.0, **overrides)
        truth = made.truth[:, 2:]
        [trajectory] = tbd.detect(made.frames, made.stamps, doppler_ambiguities=1,
                                  **options).trajectories
        error = trajectory.positions - truth
        error[:, 0] = (error[:, 0] + 16) % 32 - 16
        assert np.nanmean(np.hypot(*error.T)) < 0.7
        rate = np.gradient(truth[:, 1])
        if np.abs(rate).min() > 4.0:
            beyond += 1
            plain = tbd.detect(made.frames, made.stamps, **options).trajectories
            assert all(np.nanmean(np.abs(one.velocity[:, 1] - rate)) > 1.0 for one in plain)
    assert beyond > 0


def test_masked_pixels_and_noise_of_wrapped_maps_go_round_with_the_columns():
    k = 0.15
    columns = 23.6 + 24 + 0 * np.arange(10.0)
    maps, rows = maps_around(columns, k, 9.0)
    maps = maps + np.random.default_rng(2).standard_normal(maps.shape)
    maps[3:5, :, :2] = np.nan
    [trajectory] = tbd.detect(maps, motion_model='range_doppler', doppler_ambiguities=1,
                              range_bins_per_doppler_bin=k, threshold=7.5,
                              variance=np.ones((120, 24))).trajectories
    assert np.abs(trajectory.positions[:, 1] - rows).mean() < 0.5


def test_realised_rate_with_ambiguous_doppler_is_the_requested_one(calibrate_on):
    calibrate_on(300)
    rate, shape, stamps = 0.3, (180, 24), np.arange(8.0)
    detector = ConvexDetector(DetectorOptions(
        psf_sigma_px=2.0, motion_model='range_doppler', range_bins_per_doppler_bin=0.2,
        doppler_ambiguities=1, false_alarm_rate=rate))
    bound = detector.threshold(stamps, shape)
    search = detector.noise_study(stamps, shape).searcher(shape)
    assert_rate_is_realised(lambda generator: search(generator) > bound, rate, 200, 12)


@pytest.mark.parametrize(('options', 'message'), [
    ({'motion_model': 'range_bearing'}, 'ambiguities=1 without motion_model=range_doppler'),
    ({'detector': 'mt_dp'}, 'mt_dp cannot honour doppler_ambiguities=1 without'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0,
      'registration': 'translation'}, 'registration=translation with doppler_ambiguities'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0,
      'psf_sigma_px': 4.0}, 'at least .* columns'),
])
def test_ambiguities_that_cannot_be_searched_are_refused(options, message):
    with pytest.raises(tbd.ParameterError, match=message):
        tbd.detect(np.zeros((4, 16, 16)), threshold=8, doppler_ambiguities=1, **options)
