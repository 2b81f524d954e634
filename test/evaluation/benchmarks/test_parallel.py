import json

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.benchmarks import (
    parallel as bench_parallel,
)
from track_before_detect.evaluation.benchmarks import (
    velocity_filter as bench_velocity,
)
from track_before_detect.evaluation.studies.parallel import scenes as parallel_scenes
from track_before_detect.solvers.calibration.noise_study import noise_frames


def quiet(label, done):
    assert label and 0 <= done <= 1


@pytest.fixture(scope='module')
def measured():
    case = bench_parallel.Case('tiny', (30, 32), lambda rng: parallel_scenes.many_targets(
        3, 20.0, rng, (30, 32)), 30, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench_parallel, 'CASES', (case,))
        return bench_parallel.measure_parallel(2, False, quiet)


def test_candidates_and_times_of_both_methods_are_measured(measured):
    [case] = measured['cases']
    cells = 5 * 30 * 32
    for name, size in (('mt_dp', 9), ('pc_dp', 16)):
        assert case['detected'][name] > 0.6
        # Everything once, at least, and no more than everything for each target.
        assert cells * size <= case['candidates'][name] <= case['plain'][name]
        assert case['candidates_of_slowest'][name] <= case['candidates'][name]
    assert case['eq_18'] > 0
    assert set(case['times']) == {'statistic', 'mt_dp', 'pc_dp, 1 thread', 'pc_dp, 2 threads'}
    assert json.loads(json.dumps(measured)) == measured
    assert 'Eq. 18' in bench_parallel.parallel_table(measured)


def test_velocities_are_measured_beside_numpy(monkeypatch):
    monkeypatch.setattr(bench_velocity, 'SIDES_PX', (24,))
    monkeypatch.setattr(bench_velocity, 'N_FRAMES', 8)
    measured = bench_velocity.measure_velocity(2, True, quiet)
    [case] = measured['cases']
    assert case['n_velocities'] == 15**2
    assert case['largest_difference'] < 1e-4
    assert case['additions'] < case['plain_additions']
    assert json.loads(json.dumps(measured)) == measured
    assert '225' in bench_velocity.velocity_table(measured)


@pytest.mark.parametrize('measure', [bench_parallel.measure_parallel,
                                     bench_velocity.measure_velocity])
def test_no_repeats_are_refused(measure):
    with pytest.raises(ParameterError, match='repeats must be at least 1, got 0'):
        measure(0, False, quiet)


def test_six_targets_are_where_the_paper_puts_them():
    scene = parallel_scenes.six_targets(8.0, np.random.default_rng(0))
    assert scene.frames.shape == (6, 50, 50) and scene.cells.shape == (6, 6, 2)
    np.testing.assert_allclose(scene.positions[:, 0, 0], [13.1, 20.1, 10.1, 30.1, 30.1, 35.1])
    np.testing.assert_allclose(scene.positions[:, -1] - scene.positions[:, 0],
                               5 * np.array([[1, 0.9], [-1, 1], [1, 0.9], [1, 0], [1, 0],
                                             [-0.9, 1]]))


def test_process_noise_has_the_covariance_of_the_paper():
    rng = np.random.default_rng(1)
    moved = np.array([parallel_scenes._move(np.zeros((1, 4)), rng, 0.3)[0, 1]
                      for _ in range(4000)])
    np.testing.assert_allclose(np.cov(moved.T), 0.3 / 3 * np.eye(2), atol=0.01)


def test_power_of_a_target_and_of_the_noise_are_as_stated():
    rng = np.random.default_rng(2)
    noise = noise_frames(rng, (6, 200, 200), True)
    assert np.mean(np.abs(noise)**2) == pytest.approx(1, abs=0.02)
    scene = parallel_scenes.draw_scene([(25.0, 0.0, 25.0, 0.0)] * 1, 60.0, rng)
    assert np.abs(scene.frames[:, 25, 25])**2 == pytest.approx(1e6, rel=0.02)
