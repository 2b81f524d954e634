"""The suite range-doppler measures what it says, on scenes small enough to check."""

import dataclasses

import numpy as np
import pytest

from track_before_detect.evaluation import range_doppler_suite as suite
from track_before_detect.evaluation.runner import Runner


def quiet(label, done):
    pass


@pytest.fixture
def small(monkeypatch):
    """Make the maps few and small, and the targets slower."""
    scene = dataclasses.replace(suite.SCENE, height=64, width=24, n_frames=6, psf_sigma_px=2.0,
                                speed_px_per_frame=2.0)
    overrides = {name: getattr(scene, name) for name in
                 ('height', 'width', 'n_frames', 'psf_sigma_px', 'speed_px_per_frame')}
    monkeypatch.setattr(suite, 'SCENE', scene)
    monkeypatch.setattr(suite, 'simulate',
                        lambda name, seed, simulate=suite.simulate:
                        simulate(name, seed, **overrides))
    monkeypatch.setitem(suite.MOTIONS['uncoupled'], 'max_speed_px_s', 2.0)
    suite._search.cache_clear()
    yield scene
    suite._search.cache_clear()


def test_suite_reports_the_gain_of_paired_scenes(small):
    result = suite.run_range_doppler(4, 1, Runner(quiet))
    assert len(result.rows) == 4
    both = np.array([[row['snr_coupled'], row['snr_uncoupled']] for row in result.rows])
    assert (both > suite.SNRS[0]).all() and (both < suite.SNRS[1]).all()
    by_name = {quantity.name: quantity for quantity in result.quantities}
    gain = by_name['gain of the coupling, mean over targets']
    assert gain.value == pytest.approx(np.mean(20 * np.log10(both[:, 1] / both[:, 0])))
    assert gain.low <= gain.value <= gain.high
    again = suite.run_range_doppler(4, 1, Runner(quiet))
    assert again.rows == result.rows


def test_target_is_found_from_its_snr_on(small):
    item = {'motion': 'coupled', 'seed': 5, 'bound': 30.0}
    snr = suite.snr_of_detection(item)['snr']
    higher = suite.snr_of_detection({**item, 'bound': 40.0})['snr']
    assert suite.SNRS[0] < snr < higher < suite.SNRS[1]


def test_noise_has_unit_power_and_its_statistic_that_of_two_halves(small):
    noise = suite.complex_noise(np.random.default_rng(1))
    assert np.mean(np.abs(noise)**2) == pytest.approx(1.0, abs=0.05)
    scores = suite._search('coupled').scores(noise)
    inside = scores[scores >= 0]
    assert inside.mean() == pytest.approx(1.0, abs=0.1)
    assert inside.var() == pytest.approx(1.0, abs=0.3)


def test_tail_of_a_gumbel_distribution_is_found():
    values = np.random.default_rng(2).gumbel(40.0, 1.3, 20000)
    assert suite.tail_value(values) == pytest.approx(np.quantile(values, 0.95), abs=0.1)
