"""Thresholds without a search of noise: the model, its range, its table."""

from importlib import resources
import json
from pathlib import Path

import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration import false_paths, threshold
from track_before_detect.solvers.calibration.threshold import (
    CACHED,
    calibrate,
    level_passed,
    MODEL,
    SIMULATED,
)
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.detectors import make_detector

ROOT = Path(__file__).parents[3]
SHAPE = (48, 56)


def study_of(n_frames=12, shape=SHAPE, **options):
    detector = ConvexDetector(DetectorOptions(max_memory_gb=1.0, **options))
    return detector.noise_study(np.arange(float(n_frames)), shape)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(threshold, 'LEAST_CROPS', 20)
    monkeypatch.setattr(threshold, 'MOST_CROPS', 20)


@pytest.mark.parametrize('options', [
    pytest.param({}, id='default'),
    pytest.param({'amplitude_model': 'constant', 'psf_sigma_px': 0.8}, id='constant'),
    pytest.param({'motion_model': 'static', 'psf_sigma_px': 1.5}, id='static'),
    pytest.param({'max_acceleration_px_s2': 0.25, 'amplitude_model': 'constant'}, id='turns'),
    pytest.param({'presence': 'partial'}, id='partial'),
    pytest.param({'presence': 'partial', 'amplitude_model': 'constant', 'amplitudes': 'signed',
                  'motion_model': 'constant_velocity', 'max_speed_px_s': 0.4},
                 id='constant, partial, signed'),
])
def test_as_many_batches_of_noise_pass_as_the_model_says(options):
    study, n_batches, rate = study_of(**options), 120, 0.3
    level = level_passed(study.false_paths, rate)
    search, generator = study.searcher(SHAPE), np.random.default_rng(31)
    passing = sum(search(generator) > level for _ in range(n_batches))
    # Four standard deviations of the count, and a fifth for what the model leaves out.
    spread = 4 * np.sqrt(n_batches * rate * (1 - rate))
    assert n_batches * rate / 1.2 - spread < passing < n_batches * rate * 1.2 + spread


def test_threshold_of_the_model_falls_with_the_rate_and_rises_with_the_size_without_a_search():
    def modelled(rate, shape=SHAPE, **options):
        study = study_of(shape=shape, **options)
        found = calibrate(study, shape, rate)
        assert found.source == MODEL
        return found.threshold

    rates = [modelled(rate) for rate in (0.005, 0.05, 0.5)]
    assert (np.diff(rates) < 0).all()
    assert modelled(0.05, (480, 640)) > modelled(0.05, (128, 128)) > rates[1]
    assert modelled(0.05, psf_sigma_px=2.0) < rates[1] < modelled(0.05, max_speed_px_s=1.5)


@pytest.mark.parametrize('options', [
    {'psf_sigma_px': 5.0}, {'n_frames': 100}, {'n_frames': 3},
    {'n_frames': 3, 'presence': 'partial'}, {'amplitudes': 'complex'},
    {'shape': (16, 200)}, {'max_speed_px_s': 3.8},
    {'motion_model': 'range_bearing'}, {'psf': np.ones((3, 3))}, {'exposure_s': 0.5},
    {'max_acceleration_px_s2': 3.0}])
def test_other_options_are_left_to_a_search_of_noise(options):
    assert study_of(**options).false_paths is None


def test_noise_that_was_searched_before_goes_before_the_model():
    study = study_of(n_frames=6)
    assert calibrate(study, SHAPE, 0.05).source == MODEL
    searched = calibrate(study, SHAPE, 0.05, simulate=True)
    assert searched.source == SIMULATED
    assert calibrate(study, SHAPE, 0.05) == (searched.threshold, CACHED)


def test_detector_says_where_its_threshold_comes_from(caplog):
    caplog.set_level('INFO', 'track_before_detect')
    stamps = np.arange(12.0)
    detector = make_detector(DetectorOptions())
    assert detector.threshold_source == ''
    detector.threshold(stamps, SHAPE)
    assert detector.threshold_source == MODEL
    assert 'for a false alarm rate of 0.05 is known by the model of noise' in caplog.text
    both = make_detector(DetectorOptions(amplitude_model='either'))
    both.threshold(stamps, SHAPE)
    assert both.threshold_source == MODEL
    given = make_detector(DetectorOptions(threshold=8.0))
    given.threshold(stamps, SHAPE)
    assert given.threshold_source == 'given'


def test_table_is_the_summary_of_the_study_that_made_it_and_names_every_correction():
    file = resources.files(false_paths.__package__).joinpath(false_paths.TABLE)
    text = file.read_text(encoding='utf-8')
    assert len(text) < 12_000
    assert text == (ROOT / 'docs' / 'false-paths' / 'summary.json').read_text(encoding='utf-8')
    table = json.loads(text)
    assert table['command'].startswith('tbd evaluate false-paths ')
    detector = ConvexDetector(DetectorOptions())
    graph = detector.graph(np.arange(20.0), (128, 128))
    one = np.ones(1)
    names = list(false_paths.corrections(graph, detector.measurement, one, one))
    assert {'Constant', 'NonNegative'} <= set(table['settings']['coefficients'])
    for kind, coefficients in table['settings']['coefficients'].items():
        assert list(coefficients) == (
            names if kind in ('Constant', 'NonNegative')
            else ['all', 'ends'] if 'partial' in kind else ['all'])
        assert np.isfinite(list(coefficients.values())).all()
    assert all(low <= high for low, high in table['settings']['range'].values())
