"""The suite range-doppler measures what it says, on scenes small enough to check."""

import dataclasses

import numpy as np
import pytest

from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.range_doppler import suite
from track_before_detect.types import FrameBatch


def quiet(label, done):
    pass


@pytest.fixture
def small(monkeypatch, calibrate_on):
    """Make the maps few and small, the targets slower and the calibration short."""
    scene = dataclasses.replace(suite.SCENE, height=64, width=24, n_frames=6, psf_sigma_px=2.0,
                                speed_px_per_frame=2.0)
    overrides = {name: getattr(scene, name) for name in
                 ('height', 'width', 'n_frames', 'psf_sigma_px', 'speed_px_per_frame')}
    calibrate_on(150)
    monkeypatch.setattr(suite, 'SCENE', scene)
    monkeypatch.setattr(suite, 'simulate',
                        lambda name, seed, simulate=suite.simulate:
                        simulate(name, seed, **overrides))
    monkeypatch.setitem(suite.MOTIONS['uncoupled'], 'max_speed_px_s', 2.0)
    suite._detector.cache_clear()
    yield scene
    suite._detector.cache_clear()


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


@pytest.mark.parametrize('motion', suite.MOTIONS)
def test_target_is_found_from_its_snr_on(small, motion):
    item = {'motion': motion, 'seed': 5, 'threshold': 5.5}
    snr = suite.snr_of_detection(item)['snr']
    higher = suite.snr_of_detection({**item, 'threshold': 6.5})['snr']
    assert suite.SNRS[0] < snr < higher < suite.SNRS[1]


@pytest.mark.parametrize('motion', suite.MOTIONS)
def test_noise_raises_an_alarm_below_its_largest_statistic_and_none_above(small, motion):
    noise = suite._noise(np.random.default_rng(7))
    detector = suite._detector(motion, 8.0)
    step = detector.detect(FrameBatch.of(noise, suite._stamps())).history[0]
    largest = 8.0 * (1 + step.violation)
    # Moving off the grid raises a path by no more than this.
    most = (largest**2 + detector.model.refinement_gain)**0.5
    item = {'motion': motion, 'seed': 7}
    assert suite.false_alarm({**item, 'threshold': 0.98 * largest})['alarm']
    assert not suite.false_alarm({**item, 'threshold': 1.02 * most})['alarm']
