import numpy as np
import pytest

from canned import Canned, quiet
from naive import gaussian_stamp_image
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.accuracy.runs import isolated_target
from track_before_detect.evaluation.studies.accuracy.suite import cramer_rao, run_accuracy
from track_before_detect.runs.workers import Workers


def test_bound_is_the_inverse_of_the_information_in_the_frames():
    # Place and velocity on one axis, from numerical derivatives of the stamps.
    times = np.arange(20) - 9.5
    information = np.zeros((2, 2))
    for t in times:
        derivative = (gaussian_stamp_image((41, 41), 20.25 + 1e-5, 20.4, 1.0)
                      - gaussian_stamp_image((41, 41), 20.25 - 1e-5, 20.4, 1.0)) / 2e-5
        information += 100 * np.sum(derivative**2) * np.outer([1, t], [1, t])
    covariance = np.linalg.inv(information)
    expected = [np.sqrt([1, t] @ covariance @ [1, t]) for t in times]
    np.testing.assert_allclose(cramer_rao(10.0), expected, rtol=2e-3)


def test_accuracy_of_bright_targets_is_near_the_bound():
    result = run_accuracy(8, 1, Canned(), snrs=(30.0,), side_px=40)
    by_name = {quantity.name: quantity for quantity in result.quantities}
    assert by_name['SNR 30: target found'].value == 1.0
    assert 0.6 < by_name['SNR 30: position RMSE over the bound'].value < 1.6
    assert by_name['SNR 30: no second trajectory of the target'].value == 1
    assert by_name['SNR 30: amplitude over the true one'].value == pytest.approx(1, abs=0.02)
    assert by_name['SNR 30, target of 1.3 px: no second trajectory of it'].value > 0.7
    assert len(result.rows) == 16


ITEM = {'snr': 20.0, 'sigma_px': 1.0, 'threshold': 9.0, 'side_px': 64}


def test_other_processes_give_the_same_results():
    # Those of a cluster: cli/test_many_recordings.py.
    pytest.importorskip('joblib')
    items = [{**ITEM, 'seed': seed} for seed in range(3)]
    here = Runner(quiet).map(isolated_target, items, 'measuring')
    there = Runner(quiet, Workers(2, 'loky')).map(isolated_target, items, 'measuring')
    assert there == here
