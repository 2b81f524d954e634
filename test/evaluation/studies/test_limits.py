import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.engine.runner import Runner, Workers
from track_before_detect.evaluation.studies.limits import (
    runs as limit_runs,
)
from track_before_detect.evaluation.studies.limits import (
    suites as limit_suites,
)
from track_before_detect.evaluation.studies.limits.line_filter import LineFilter
from track_before_detect.simulation.sensor import add_target, gaussian_stamp_image


def quiet(label, done):
    assert label and 0 <= done <= 1


@pytest.fixture
def no_calibration(monkeypatch):
    monkeypatch.setattr(limit_suites, '_threshold', lambda *_: 7.9)


def slow_best(frames, model, max_speed):
    """Return the largest statistic, one stamp and one path at a time."""
    n_frames, height, width = frames.shape
    places = [(x / 2, y / 2) for y in range(2 * height - 1) for x in range(2 * width - 1)]
    h = {}
    for x, y in places:
        stamp = gaussian_stamp_image((height, width), x, y, 1.0)
        h[x, y] = np.tensordot(frames, stamp / np.linalg.norm(stamp), axes=2)
    times = np.arange(n_frames) - (n_frames - 1) / 2
    steps = [k / (n_frames - 1) for k in range(-(n_frames - 1), n_frames)]
    best = 0.0
    for vx in steps:
        for vy in steps:
            if np.hypot(vx, vy) > max_speed + 1e-9:
                continue
            moves = np.rint(2 * times[:, None] * [vx, vy]) / 2
            for x, y in places:
                path = [(x + dx, y + dy) for dx, dy in moves]
                if all(place in h for place in path):
                    values = np.array([h[place][t] for t, place in enumerate(path)])
                    best = max(best, values.sum() / n_frames**0.5 if model == 'constant'
                               else np.sqrt((values.clip(0)**2).sum()))
    return best


@pytest.mark.parametrize('model', ['constant', 'fluctuating'])
def test_exhaustive_search_equals_a_slow_one(model):
    frames = np.random.default_rng(4).standard_normal((4, 7, 9)).astype(np.float32)
    ours = LineFilter(4, 1.0, 1.0, model).best(frames)
    assert ours == pytest.approx(slow_best(frames, model, 1.0), rel=1e-4)


@pytest.mark.parametrize('model', ['constant', 'fluctuating'])
def test_path_near_a_bright_target_is_the_best_of_all(model):
    truth = np.array([12.3, 14.1]) + np.arange(6)[:, None] * [0.7, -0.4]
    frames = np.random.default_rng(1).standard_normal((6, 30, 30)).astype(np.float32)
    for frame, (x, y) in zip(frames, truth, strict=True):
        add_target(frame, x, y, 1.0, 8.0)
    search = LineFilter(6, 1.0, 1.0, model)
    assert search.best_near(frames, truth, 2.0) == pytest.approx(search.best(frames), rel=1e-5)
    assert search.best_near(frames, truth + 10, 2.0) < 0.7 * search.best(frames)


def test_paths_near_a_target_are_all_that_are():
    rng = np.random.default_rng(3)
    frames = rng.standard_normal((5, 16, 16)).astype(np.float32)
    search = LineFilter(5, 1.0, 1.0, 'constant')
    truth = np.array([7.0, 8.0]) + np.arange(5)[:, None] * [0.5, 0.2]
    truth[2] += 1.0
    scores = search._scores(frames)
    best = -np.inf
    for offsets in search._offsets:
        for y in range(31):
            for x in range(31):
                places = [x, y] + offsets
                if (places >= 0).all() and (places < 31).all() and np.linalg.norm(
                        places / 2 - truth, axis=1).mean() < 2.0:
                    best = max(best, scores[np.arange(5), places[:, 1], places[:, 0]].sum())
    assert search.best_near(frames, truth, 2.0) == pytest.approx(best / 5**0.5, rel=1e-5)
    with pytest.raises(ParameterError, match="model must be constant or fluctuating, got 'odd'"):
        LineFilter(5, 1.0, 1.0, 'odd')


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
    np.testing.assert_allclose(limit_suites.cramer_rao(10.0), expected, rtol=2e-3)


def test_accuracy_of_bright_targets_is_near_the_bound(no_calibration, monkeypatch):
    monkeypatch.setattr(limit_suites, 'ACCURACY_SNRS', (30.0,))
    monkeypatch.setattr(limit_runs, 'ACCURACY_PX', 40)
    result = limit_suites.run_accuracy(12, 1, Runner(quiet))
    by_name = {quantity.name: quantity for quantity in result.quantities}
    assert by_name['SNR 30: target found'].value == 1.0
    assert 0.6 < by_name['SNR 30: position RMSE over the bound'].value < 1.6
    assert by_name['SNR 30: no second trajectory of the target'].value == 1
    assert by_name['SNR 30: amplitude over the true one'].value == pytest.approx(1, abs=0.02)
    assert by_name['SNR 30, target of 1.3 px: no second trajectory of it'].value > 0.7
    assert len(result.rows) == 24


def test_dim_suite_counts_what_passes_either_threshold(no_calibration, monkeypatch):
    monkeypatch.setattr(limit_suites, 'DIM_SNRS', (2.0,))
    monkeypatch.setattr(limit_runs, 'dim_noise', lambda item: {
        'constant': 5.0 + 1e-14 * item['seed'] % 1, 'fluctuating': 7.0})
    monkeypatch.setattr(limit_runs, 'dim_target', lambda item: {
        'found': {'constant': True, 'fluctuating': item['motion'] == 'line'},
        'nearby': {'constant': 9.0, 'fluctuating': None}})
    result = limit_suites.run_dim(8, 2, Runner(quiet))
    values = {quantity.name: quantity.value for quantity in result.quantities}
    assert values['line, SNR 2, fluctuating: found'] == 1.0
    assert values['arc, SNR 2, fluctuating: found'] == 0.0
    assert values['arc, SNR 2, constant: exhaustive search'] == 1.0
    assert values['arc, SNR 2, fluctuating: exhaustive search'] == 0.0
    assert len({row['seed'] for row in result.rows}) == 16


def test_alarms_of_a_higher_threshold_are_among_those_of_a_lower_one():
    counts = np.zeros(3)
    for seed in range(6):
        item = {'side_px': 32, 'thresholds': [20.0, 7.0, 6.0], 'seed': seed}
        alarms = limit_runs.noise_alarms(item)['alarms']
        assert alarms == sorted(alarms)
        counts += alarms
    assert counts[0] == 0 and counts[2] == 6


ITEM = {'snr': 20.0, 'sigma_px': 1.0, 'threshold': 9.0}


@pytest.mark.parametrize('backend', ['loky', 'dask'])
def test_other_processes_give_the_same_results(backend):
    pytest.importorskip('joblib')
    if backend == 'dask':
        pytest.importorskip('distributed')
    items = [{**ITEM, 'seed': seed} for seed in range(3)]
    here = Runner(quiet).map(limit_runs.isolated_target, items, 'measuring')
    there = Runner(quiet, Workers(2, backend)).map(limit_runs.isolated_target, items, 'measuring')
    assert there == here
