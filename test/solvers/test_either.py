"""Amplitudes that are constant or fluctuate, untold which: two searches, one result."""

import numpy as np
import pytest

from false_alarms import assert_rate_is_realised
import track_before_detect as tbd
from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_path
from track_before_detect.solvers.detectors import make_detector
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch

T, H, W = 12, 40, 44
STAMPS = np.arange(float(T))
FREE, STEADY = (np.arange(T) % 3 + 1.0) / 2, np.ones(T)


@pytest.fixture(scope='module', autouse=True)
def quick_calibration(tmp_path_factory):
    """Let thresholds be rough, and each be found once for all tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('XDG_CACHE_HOME', str(tmp_path_factory.mktemp('cache')))
        patch.setattr('track_before_detect.solvers.calibration.threshold.MOST_CROPS', 160)
        yield


def line(x, y, vx=0.6, vy=-0.3):
    return np.array([[x + vx * t, y + vy * t] for t in range(T)])


def frames_of(*targets, seed=0, sigma=1.0, noise=1.0):
    frames = noise * np.random.default_rng(seed).standard_normal((T, H, W)).astype(np.float32)
    for path, amplitudes in targets:
        add_path(frames, path, sigma, amplitudes)
    return frames


def search(frames, model='either', **options):
    detector = make_detector(DetectorOptions(amplitude_model=model, **options))
    return detector.detect(FrameBatch.of(frames, np.arange(float(len(frames)))))


def shares_of(rate):
    """Give most of a rate to constant amplitudes: fluctuating ones need little of it."""
    return {'fluctuating': 0.15 * rate, 'constant': 0.85 * rate}


def error_px(found, path):
    return np.nanmean(np.hypot(*(found.positions - path).T))


@pytest.mark.parametrize('detector', ['convex', 'greedy'])
@pytest.mark.parametrize('options', [{}, {'amplitudes': 'signed'}, {'presence': 'partial'}],
                         ids=['non-negative', 'signed', 'partial'])
def test_targets_of_both_kinds_are_found_once_each_by_the_model_that_explains_them(
        detector, options):
    paths = line(6, 14), line(12, 30)
    frames = frames_of((paths[0], 6 * STEADY), (paths[1], 6 * FREE), noise=0.5)
    result = search(frames, detector=detector, **options)
    assert result.status == 'converged' and len(result.found) == 2
    by_place = sorted(result.found, key=lambda one: np.nanmean(one.positions[:, 1]))
    for found, path, constant in zip(by_place, paths, (True, False), strict=True):
        assert error_px(found, path) < 0.7
        # Beside the positions of greedy, which are those of the grid, amplitudes differ.
        assert bool(np.nanstd(found.amplitudes) < 1e-6) is constant or detector == 'greedy'
    statistics = [one.statistic for one in result.found]
    assert statistics == sorted(statistics, reverse=True) and min(statistics) > result.threshold


@pytest.mark.parametrize(('amplitudes', 'finder'), [
    (1.9 * STEADY, 'constant'), (10.0 * (np.arange(T) == 5), 'fluctuating')],
    ids=['dim', 'one frame'])
def test_what_only_one_model_finds_is_found(amplitudes, finder):
    frames = frames_of((line(9, 20, 0, 0), amplitudes), noise=0.0)
    counts = {model: len(search(frames, model).found)
              for model in ('constant', 'fluctuating', 'either')}
    assert counts == {'constant': 0, 'fluctuating': 0, finder: 1, 'either': 1}


def test_statistics_are_on_the_scale_of_fluctuating_amplitudes():
    frames = frames_of((line(9, 20), 7 * STEADY))
    told = {model: search(frames, model, false_alarm_rate=rate)
            for model, rate in shares_of(0.1).items()}
    result = search(frames, false_alarm_rate=0.1)
    assert result.threshold == told['fluctuating'].threshold
    [found], [constant] = result.found, told['constant'].found
    excess = constant.statistic**2 - told['constant'].threshold**2
    assert found.statistic**2 - result.threshold**2 == pytest.approx(excess)
    assert np.array_equal(found.positions, constant.positions)


@pytest.mark.parametrize('given', [5.0, 7.5, 20.0])
def test_given_threshold_holds_for_both_at_equal_distance_from_that_of_the_rate(given):
    shape = H, W
    detector = make_detector(DetectorOptions(amplitude_model='either', threshold=given))
    assert detector.threshold(STAMPS, shape) == given
    free, constant = (make_detector(DetectorOptions(
        amplitude_model=model, false_alarm_rate=rate)).threshold(STAMPS, shape)
        for model, rate in shares_of(0.05).items())
    share = given * constant / free
    expected = share if given < free else np.sqrt(given**2 - free**2 + constant**2)
    assert expected >= share
    for factor, count in ((1.01, 1), (0.99, 0)):
        amplitude = factor * expected / np.sqrt(T)
        frames = frames_of((line(9, 20, 0, 0), amplitude * STEADY), noise=0.0)
        result = detector.detect(FrameBatch.of(frames, STAMPS))
        assert (len(result.found), result.threshold) == (count, given)


@pytest.mark.parametrize(('spread', 'sigma'), [(0.1, 1.1), (1.0, 1.1), (1.0, 1.0)])
@pytest.mark.parametrize('n_targets', [1, 3])
def test_very_bright_targets_leave_nothing_that_looks_like_another(spread, sigma, n_targets):
    """What a constant amplitude leaves of a target of SNR 50 would be many more to it."""
    rng = np.random.default_rng(3)
    for seed in range(3):
        targets = [(line(8 + 6 * n, 10 + 11 * n),
                    50 * (1 + spread * rng.uniform(-0.9, 0.9, T))) for n in range(n_targets)]
        frames = frames_of(*targets, seed=seed, sigma=sigma)
        found = [one.positions for one in search(frames).found]
        assert len(found) == n_targets
        assert len(match_trajectories(found, np.array([path for path, _ in targets]), 0.5)
                   .pairs) == n_targets


def test_dim_target_of_constant_amplitude_is_found_beside_bright_ones_that_fluctuate():
    dim, bright = line(9, 20), line(9, 25)
    frames = frames_of((bright, 30 * FREE), (line(20, 34), 30 * FREE), (dim, 1.8 * STEADY),
                       noise=0.3)
    assert len(search(frames, 'fluctuating').found) == 2
    result = search(frames)
    assert len(result.found) == 3 and error_px(result.found[-1], dim) < 1.0


def test_dim_targets_that_cross_are_found_as_by_the_detector_told_that_they_are_constant():
    paths = line(13, 20, 0.8, 0.0), line(17.4, 15.6, 0.0, 0.8)
    counts = {'constant': 0, 'either': 0}
    for seed in range(12):
        frames = frames_of(*((path, 2.1 * STEADY) for path in paths), seed=seed)
        for model in counts:
            found = [one.positions for one in search(frames, model).found]
            counts[model] += len(match_trajectories(found, np.array(paths), 2.0).pairs)
    assert counts['either'] >= counts['constant'] - 3 and counts['constant'] > 18


def test_noise_passes_as_rarely_as_asked(calibrate_on):
    calibrate_on(400)
    detector = make_detector(DetectorOptions(
        amplitude_model='either', max_speed_px_s=0.0, false_alarm_rate=0.3))

    def passes(generator):
        noise = generator.standard_normal((4, 10, 12)).astype(np.float32)
        return bool(detector.detect(FrameBatch.of(noise, np.arange(4.0))).found)

    assert_rate_is_realised(passes, 0.3, 200, seed=5)


def test_batches_go_on_from_those_before_under_one_identity():
    path = np.array([[6 + 0.6 * t, 20.0] for t in range(2 * T)])
    frames = np.random.default_rng(1).standard_normal((2 * T, H, W)).astype(np.float32)
    add_path(frames, path, 1.0, 4.0)
    result = tbd.detect(frames, amplitude_model='either', batch_length=T, hop=T // 2)
    [found] = result.trajectories
    assert np.isfinite(found.positions).all() and error_px(found, path) < 0.7


@pytest.mark.parametrize(('motion_model', 'n_searches'), [
    pytest.param('nearly_constant_velocity', 0, id='thresholds known'),
    pytest.param('range_bearing', 2, id='thresholds searched')])
def test_warm_up_prepares_both_models(motion_model, n_searches):
    told = []
    pipeline = TrackingPipeline(DetectorOptions(
        amplitude_model='either', max_speed_px_s=0.7, motion_model=motion_model))
    threshold = pipeline.warm_up((H, W), 1.0, T, lambda label, share: told.append((label, share)))
    assert told[0] == ('compiling', 0.0) and ('compiling', 1.0) in told
    assert [share for _, share in told].count(1.0) == 1 + n_searches
    frames = frames_of((line(9, 20), 7 * STEADY))
    told.clear()
    result = pipeline.process(FrameBatch.of(frames), lambda *now: told.append(now))
    assert result.threshold == threshold and not told


@pytest.mark.parametrize('options', [
    {'amplitudes': 'complex'}, {'exposure_s': 0.5}, {'detector': 'mt_dp'}, {'detector': 'pc_dp'},
    {'detector': 'mff_dpr'}, {'detector': 'velocity_filter'}])
def test_what_cannot_be_searched_by_both_is_refused(options):
    with pytest.raises(ParameterError, match=r'cannot honour (amplitude_model=either|exposure_s)'):
        make_detector(DetectorOptions(amplitude_model='either', **options))
