"""The suite range-doppler measures what it says, on scenes small enough to check."""

import numpy as np
import pytest

from canned import Canned
from track_before_detect.evaluation.engine.detectors import detector_of, stamps_of
from track_before_detect.evaluation.studies.range_doppler.runs import (
    false_alarm,
    noise_maps,
    snr_of_detection,
    SNRS,
)
from track_before_detect.evaluation.studies.range_doppler.suite import (
    options_of,
    run_range_doppler,
)
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.types import FrameBatch

# Maps that are small, and targets that are slower.
SMALL = {'height': 64, 'width': 24, 'n_frames': 6, 'psf_sigma_px': 2.0, 'speed_px_per_frame': 2.0}
SHAPE = (6, 64, 24)
OPTIONS = options_of(simulate('range_doppler', 0, **SMALL).scenario)


def test_suite_reports_the_gain_of_paired_scenes():
    result = run_range_doppler(4, 1, Canned(any_threshold=5.5), **SMALL)
    assert len(result.rows) == 4
    both = np.array([[row['snr_coupled'], row['snr_uncoupled']] for row in result.rows])
    assert (both > SNRS[0]).all() and (both < SNRS[1]).all()
    by_name = {quantity.name: quantity for quantity in result.quantities}
    gain = by_name['gain of the coupling, mean over targets']
    assert gain.value == pytest.approx(np.mean(20 * np.log10(both[:, 1] / both[:, 0])))
    assert gain.low <= gain.value <= gain.high
    again = run_range_doppler(4, 1, Canned(any_threshold=5.5), **SMALL)
    assert again.rows == result.rows


@pytest.mark.parametrize('motion', OPTIONS)
def test_target_is_found_from_its_snr_on(motion):
    item = {'shape': SHAPE, 'overrides': SMALL, 'seed': 5}
    snr, higher = (
        snr_of_detection({**item, 'options': {**OPTIONS[motion], 'threshold': threshold}})['snr']
        for threshold in (5.5, 6.5))
    assert SNRS[0] < snr < higher < SNRS[1]


@pytest.mark.parametrize('motion', OPTIONS)
def test_noise_raises_an_alarm_below_its_largest_statistic_and_none_above(motion):
    noise = noise_maps(np.random.default_rng(7), SHAPE)
    detector = detector_of({**OPTIONS[motion], 'threshold': 8.0})
    step = detector.detect(FrameBatch.of(noise, stamps_of(len(noise)))).history[0]
    largest = 8.0 * (1 + step.violation)
    # Moving off the grid raises a path by no more than this.
    most = (largest**2 + detector.model.refinement_gain)**0.5
    for threshold, alarm in ((0.98 * largest, True), (1.02 * most, False)):
        item = {'shape': SHAPE, 'seed': 7,
                'options': {**OPTIONS[motion], 'threshold': threshold}}
        assert false_alarm(item)['alarm'] is alarm
