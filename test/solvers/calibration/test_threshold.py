"""The threshold asks for no more and no fewer false alarms than requested."""

import dataclasses
import io
import logging
import re
import resource
import signal

import numpy as np
import pytest
from scipy.stats import chi2

from false_alarms import assert_rate_is_realised
from track_before_detect.kernels.amplitude_codes import NON_NEGATIVE
from track_before_detect.models.amplitudes import AMPLITUDE_MODELS
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.solvers.calibration import threshold as module
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.calibration.threshold import calibrate
from track_before_detect.solvers.search.path_search import path_search

PSF = GaussianPsf(2.0)
MODEL = AMPLITUDE_MODELS[NON_NEGATIVE]


GRAPH = build_state_graph(np.arange(6.0), step_px=1.0, max_speed=1.0, max_acceleration=0.1,
                          turn_cost=3.0)


def searcher(shape):
    search = path_search(GRAPH, PSF, shape, MODEL)
    return lambda generator: np.sqrt(
        search.best_value(generator.standard_normal((6, *shape), dtype=np.float32)))


@pytest.fixture
def study():
    return NoiseStudy('paths', GRAPH.effective_area, searcher)


@pytest.fixture(scope='module')
def shared_cache(tmp_path_factory):
    return tmp_path_factory.mktemp('calibrations')


@pytest.fixture(autouse=True)
def cache(shared_cache, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(shared_cache))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(module, 'MOST_CROPS', 200)
    return tmp_path


@pytest.mark.parametrize('shape', [(32, 48), (96, 80)])
@pytest.mark.parametrize('rate', [0.3, 0.05])
def test_realised_rate_in_noise_is_the_requested_one(study, shape, rate):
    n_runs = 400
    bound = calibrate(study, shape, rate).threshold
    largest = study.searcher(shape)
    assert_rate_is_realised(lambda generator: largest(generator) > bound, rate, n_runs, 11)


def test_threshold_falls_with_the_rate_and_rises_with_the_area(study):
    values = [calibrate(study, (64, 64), rate).threshold for rate in (0.001, 0.01, 0.1, 0.4)]
    assert (np.diff(values) < 0).all()
    values = [calibrate(study, (n, n), 0.05).threshold for n in (64, 128, 512)]
    assert (np.diff(values) > 0).all()


def test_second_calibration_comes_from_the_cache(study, own_cache, monkeypatch):
    first = calibrate(study, (64, 64), 0.05).threshold
    monkeypatch.setattr(module, '_simulate', None)
    assert calibrate(study, (64, 64), 0.05).threshold == first


def array_file(values, claimed=None):
    """Return the bytes of a file of an array, whose header may claim another number of items."""
    file = io.BytesIO()
    np.save(file, values)
    kept = file.getvalue()
    was, claims = (f'({n},), }}'.encode() for n in (len(values), claimed or len(values)))
    head, _, tail = kept.partition(was)
    # The spaces behind the header make room for the digits.
    return head + claims + tail[len(claims) - len(was):]


@pytest.mark.parametrize('content', [
    b'', b'not an array', array_file(np.full(200, 'text')), array_file(np.zeros(200)),
    array_file(np.full(200, 7.0)), array_file(np.arange(200)), array_file(np.arange(9.0)),
    array_file(np.full(200, np.nan)), array_file(np.arange(200.0), 10**11),
    array_file(np.arange(200.0), 10**30),
], ids=['empty', 'foreign', 'strings', 'zeros', 'equal', 'integers', 'few', 'nan', 'huge',
        'astronomic'])
def test_spoilt_cache_is_named_and_made_anew(study, own_cache, caplog, content):
    first = calibrate(study, (64, 64), 0.05).threshold
    [file] = own_cache.rglob('*.npy')
    sound = file.read_bytes()
    file.write_bytes(content)
    assert not caplog.text
    assert calibrate(study, (64, 64), 0.05).threshold == first
    assert f'calibration in {file} cannot be used and is made anew' in caplog.text
    assert file.read_bytes() == sound


def test_without_a_home_calibrations_are_kept_among_temporary_files(study, own_cache,
                                                                   monkeypatch):
    def homeless():
        raise RuntimeError('Could not determine home directory.')

    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setattr(module.Path, 'home', homeless)
    monkeypatch.setattr('tempfile.tempdir', str(own_cache))
    assert calibrate(study, (64, 64), 0.05).threshold > 0
    assert len(list(own_cache.rglob('noise-*.npy'))) == 1


def test_full_disk_is_said_and_lived_with(study, own_cache, caplog):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limit[1]))
    try:
        assert calibrate(study, (64, 64), 0.05).threshold > 0
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, before)
    assert re.search(rf'could not be kept in {own_cache}/.*\.npy for the next run', caplog.text)
    assert not list(own_cache.rglob('*.npy'))


def test_cache_that_cannot_be_written_is_said_and_lived_with(study, own_cache, monkeypatch,
                                                            caplog):
    (own_cache / 'file').write_text('')
    monkeypatch.setenv('XDG_CACHE_HOME', str(own_cache / 'file'))
    with caplog.at_level(logging.WARNING):
        assert calibrate(study, (64, 64), 0.05).threshold > 0
    assert 'could not be kept' in caplog.text


def test_progress_rises_to_one(study, own_cache):
    seen = []
    calibrate(study, (64, 64), 0.05, lambda label, done: seen.append(done))
    assert seen == sorted(seen) and seen[-1] == 1


def test_where_a_search_takes_long_fewer_are_made_but_for_a_least_number(study):
    def count(seconds):
        return module._crop_count(dataclasses.replace(study, seconds=lambda crop: seconds),
                                  (128, 128))

    assert count(0.0) == count(0.05) == module.N_CROPS
    assert 30 / 0.1 < count(0.1) < 60 / 0.1
    assert count(10.0) == module.LEAST_CROPS


def test_crops_get_smaller_only_where_too_few_would_fit_and_maxima_can_be_scaled(study):
    def crop(seconds_of_128, least_px, shape=(200, 300), **more):
        slow = dataclasses.replace(
            study, seconds=lambda crop: seconds_of_128 * crop[0] * crop[1] / 128**2,
            least_crop_px=least_px, **more)
        return module._crop(slow, shape)

    assert crop(0.37, 32) == crop(10.0, module.CROP_PX) == (128, 128)
    assert crop(0.5, 32) == (96, 96)
    assert crop(10.0, 64) == (64, 64) and crop(10.0, 64, (40, 300)) == (40, 64)
    assert crop(0.8, 32, whole_width=True) == (32, 300)


def exponential(generator, n_crops):
    """Draw largest squares of a crop whose number of false ones falls exponentially."""
    return np.log(3e4) + generator.gumbel(size=n_crops), lambda x: 3e4 * np.exp(-x)


def chi_squared(generator, n_crops):
    """Draw largest squares of 2000 sums of twenty squares each."""
    maxima = chi2.isf(-np.expm1(np.log(generator.uniform(size=n_crops)) / 2000), 20)
    return maxima, lambda x: -2000 * np.log1p(-chi2.sf(x, 20))


@pytest.mark.parametrize('n_crops, rate, maxima, value', [
    (150, 0.05, exponential, module._exponential_value),
    (400, 0.05, exponential, module._exponential_value),
    (150, 0.05, chi_squared, lambda *seen: module._chi_squared_value(*seen, 0.5)),
    (3200, 0.005, chi_squared, lambda *seen: module._chi_squared_value(*seen, 0.5)),
    (800, 0.0005, chi_squared, lambda *seen: module._chi_squared_value(*seen, 0.5)),
])
def test_fewer_crops_leave_the_rate_within_a_half(n_crops, rate, maxima, value):
    rng = np.random.default_rng(n_crops)
    realised = []
    for _ in range(60):
        largest, expected_above = maxima(rng, n_crops)
        bound = value(np.sort(largest), -np.log1p(-rate))
        realised.append(-np.expm1(-expected_above(bound)))
    assert np.median(realised) == pytest.approx(rate, rel=0.2)
    assert np.mean(np.abs(np.log(np.array(realised) / rate)) < np.log(1.5)) > 0.7


def test_squares_that_fall_off_more_slowly_than_told_give_a_threshold_all_the_same():
    largest = np.sort(np.random.default_rng(5).pareto(0.5, 1000))
    assert largest[750] < module._chi_squared_value(largest, 0.01, 0.5) < np.inf
