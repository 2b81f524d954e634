"""Greedy: one path after the other, each fitted alone, none reconsidered."""

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.options import DetectorOptions, DETECTORS
from track_before_detect.solvers import greedy
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.detectors import DETECTOR_CLASSES
from track_before_detect.solvers.greedy import GreedyDetector
from track_before_detect.types import FrameBatch

T, H, W = 6, 20, 26
STAMPS = np.arange(float(T))


def gaussian(x, y, sigma=1.0, shape=(H, W)):
    rows, columns = np.indices(shape)
    stamp = np.exp(-((columns - x)**2 + (rows - y)**2) / (2 * sigma**2))
    return stamp / np.linalg.norm(stamp)


def detect(frames, **options):
    settings = {'threshold': 7.0, **options}
    detector = GreedyDetector(DetectorOptions(detector='greedy', **settings))
    return detector.detect(FrameBatch.of(np.asarray(frames, np.float32)))


def noise(seed, shape=(T, H, W)):
    return np.random.default_rng(seed).standard_normal(shape)


def test_targets_far_apart_are_found_as_the_convex_detector_finds_them():
    frames = noise(0) + 8 * gaussian(6, 6) + 5 * gaussian(19, 13)
    greedy_found = detect(frames).found
    convex = ConvexDetector(DetectorOptions(threshold=7.0))
    convex_found = convex.detect(FrameBatch.of(frames.astype(np.float32), STAMPS)).found
    assert len(greedy_found) == len(convex_found) == 2
    for one, other in zip(greedy_found, convex_found, strict=True):
        assert np.linalg.norm(one.positions - other.positions, axis=1).mean() < 0.5


def test_amplitudes_of_a_target_on_the_grid_are_its_own_without_shrinkage():
    amplitudes = np.array([9.0, 7.0, 8.0, 12.0, 6.0, 10.0])
    result = detect(amplitudes[:, None, None] * gaussian(12, 9))
    [found] = result.found
    assert np.all(found.positions == (12, 9))
    np.testing.assert_allclose(found.amplitudes, amplitudes, rtol=1e-5)
    assert found.statistic == pytest.approx(np.linalg.norm(amplitudes), rel=1e-5)
    assert found.snr == pytest.approx(amplitudes.mean(), rel=1e-5)
    assert (result.status, result.threshold) == ('converged', 7.0)


def test_early_path_is_never_reconsidered():
    """Two targets whose sum has one peak: the first path takes their middle and keeps it."""
    frame = 30 * (gaussian(21, 0, 3.0, (1, 50)) + gaussian(27, 0, 3.0, (1, 50)))
    result = detect(frame[None], psf_sigma_px=3.0, threshold=5.0)
    found = [path.positions[0, 0] for path in result.found]
    assert found[0] == 24 and len(found) == 3
    alone = detect(frame[None], psf_sigma_px=3.0, threshold=40.0)
    assert alone.found[0].amplitudes == pytest.approx(result.found[0].amplitudes)


@pytest.mark.parametrize('options', [
    {}, {'amplitudes': 'signed'}, {'amplitude_model': 'constant', 'threshold': 4.0}],
    ids=['non-negative', 'signed', 'constant'])
def test_every_statistic_passes_the_threshold_and_each_path_lowers_the_objective(options):
    frames = noise(1)
    for x, y in ((5, 5), (8, 6), (18, 12)):
        frames += 6 * gaussian(x, y)
    result = detect(frames, **options)
    assert len(result.found) >= 2
    statistics = [path.statistic for path in result.found]
    assert min(statistics) > result.threshold
    assert statistics == sorted(statistics, reverse=True)
    objectives = [step.objective for step in result.history]
    assert np.all(np.diff(objectives) < 0)
    assert [step.n_paths for step in result.history] == list(range(len(result.found) + 1))
    assert result.history[-1].violation <= 0 < result.history[0].violation
    if options.get('amplitudes') != 'signed':
        assert min(path.amplitudes.min() for path in result.found) >= 0
    if options.get('amplitude_model') == 'constant':
        assert all(np.ptp(path.amplitudes) < 1e-9 for path in result.found)


def test_negative_target_is_found_with_signed_amplitudes_alone():
    frames = -9 * np.repeat(gaussian(12, 9)[None], T, axis=0)
    assert not detect(frames).found
    [found] = detect(frames, amplitudes='signed').found
    np.testing.assert_allclose(found.amplitudes, -9, rtol=1e-5)


def test_masked_pixels_hold_nothing():
    frames = 9 * np.repeat(gaussian(12, 9)[None], T, axis=0)
    frames[2] = np.nan
    [found] = detect(frames).found
    assert np.isnan(found.amplitudes[2])
    np.testing.assert_allclose(np.delete(found.amplitudes, 2), 9, rtol=1e-5)


def test_search_that_is_cut_short_says_so(monkeypatch):
    monkeypatch.setattr(greedy, 'MOST_PATHS', 1)
    frames = np.repeat((20 * (gaussian(5, 5) + gaussian(19, 13)))[None], T, axis=0)
    result = detect(frames)
    assert (result.status, len(result.found)) == ('iteration_limit', 1)


def test_threshold_is_that_of_paths_on_the_grid(calibrate_on):
    calibrate_on(800)
    options = {'max_speed_px_s': 0.0, 'false_alarm_rate': 0.5}
    greedy, convex = (
        DETECTOR_CLASSES[name](DetectorOptions(detector=name, **options))
        .threshold(np.arange(2.0), (10, 12)) for name in ('greedy', 'convex'))
    # Refined paths explain more of the noise.
    assert 0.9 * convex < greedy < convex


def test_detector_is_chosen_by_name():
    assert tuple(DETECTOR_CLASSES) == DETECTORS
    frames = np.repeat((40 * (gaussian(10, 9) + gaussian(12.5, 9)))[None], T, axis=0)
    counts = {name: len(tbd.detect(frames, detector=name, threshold=7.0).trajectories)
              for name in DETECTORS}
    assert counts['convex'] == 2 < counts['greedy']
