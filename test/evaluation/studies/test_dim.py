import numpy as np
import pytest

from canned import Canned
from naive import gaussian_stamp_image
from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.studies.dim.line_filter import LineFilter
from track_before_detect.evaluation.studies.dim.suite import run_dim
from track_before_detect.simulation.sensor import add_path


def slow_best(frames, model, max_speed, truth=None, limit=np.inf):
    """Return the largest statistic of paths near a target, one stamp and one path at a time."""
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
                if truth is not None and np.linalg.norm(path - truth, axis=1).mean() >= limit:
                    continue
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
    add_path(frames, truth, 1.0, 8.0)
    search = LineFilter(6, 1.0, 1.0, model)
    assert search.best_near(frames, truth, 2.0) == pytest.approx(search.best(frames), rel=1e-5)
    assert search.best_near(frames, truth + 10, 2.0) < 0.7 * search.best(frames)


def test_paths_near_a_target_are_all_that_are():
    rng = np.random.default_rng(3)
    frames = rng.standard_normal((5, 16, 16)).astype(np.float32)
    search = LineFilter(5, 1.0, 1.0, 'constant')
    truth = np.array([7.0, 8.0]) + np.arange(5)[:, None] * [0.5, 0.2]
    truth[2] += 1.0
    best = slow_best(frames, 'constant', 1.0, truth, 2.0)
    assert search.best_near(frames, truth, 2.0) == pytest.approx(best, rel=1e-5)
    with pytest.raises(ParameterError, match="model must be constant or fluctuating, got 'odd'"):
        LineFilter(5, 1.0, 1.0, 'odd')


def test_targets_are_counted_that_pass_the_threshold_of_either_search():
    result = run_dim(8, 2, Canned(answers={
        'dim_noise': lambda item: {'constant': 5.0 + 1e-14 * item['seed'] % 1, 'fluctuating': 7.0},
        'dim_target': lambda item: {
            'found': {'constant': True, 'fluctuating': item['motion'] == 'line'},
            'nearby': {'constant': 9.0 if item['snr'] == 2.0 else 4.0, 'fluctuating': None}}}))
    values = {quantity.name: quantity.value for quantity in result.quantities}
    assert values['line, SNR 2, fluctuating: found'] == 1.0
    assert values['arc, SNR 2, fluctuating: found'] == 0.0
    assert values['arc, SNR 2, constant: exhaustive search'] == 1.0
    assert values['arc, SNR 1.5, constant: exhaustive search'] == 0.0
    assert values['arc, SNR 1.5, constant: found less exhaustive'] == 1.0
    assert values['arc, SNR 2, fluctuating: exhaustive search'] == 0.0
    # Uniform from 5 to 6.
    assert 5.8 < values['threshold of the exhaustive search, constant'] < 6.2
    assert len({row['seed'] for row in result.rows}) == 32
