import dataclasses
import json

import pytest

from canned import quiet
from track_before_detect.evaluation.benchmarks import parallel, scene, velocity_filter
from track_before_detect.evaluation.studies.parallel.scenes import many_targets


@pytest.fixture(scope='module')
def measured():
    case = parallel.Case('tiny', (30, 32), lambda rng: many_targets(3, 20.0, rng, (30, 32)), 30, 3)
    bench = dataclasses.replace(parallel.BENCH, cases=lambda large: {'cases': [case]})
    return bench.measure(2, False, quiet)


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
    assert 'Eq. 18' in parallel.BENCH.table(measured)


def test_velocities_are_measured_beside_numpy():
    bench = dataclasses.replace(velocity_filter.BENCH, cases=lambda large: {
        'cases': [velocity_filter.Square(24, n_frames=8)]})
    measured = bench.measure(2, True, quiet)
    [case] = measured['cases']
    assert case['n_velocities'] == 15**2
    assert case['largest_difference'] < 1e-4
    assert case['additions'] < case['plain_additions']
    assert json.loads(json.dumps(measured)) == measured
    assert '225' in bench.table(measured)


def test_a_panning_scene_is_measured_stage_by_stage():
    bench = dataclasses.replace(scene.BENCH, cases=lambda large: {'cases': [scene.Scene(64, 80)]})
    measured = bench.measure(2, False, quiet)
    [case] = measured['cases']
    assert case['n_trajectories'] == 1
    assert case['frames_per_s'] == pytest.approx(case['hop'] / case['batch']['wall_s']['median'])
    for stage in ('batch', 'look', 'pictures', 'noise_of_one'):
        assert 0 < case[stage]['cpu_s']['min'] <= case[stage]['cpu_s']['median']
    assert case['peak_memory_bytes'] >= case['peak_memory_before_bytes'] > 10 * 2**20
    assert json.loads(json.dumps(measured)) == measured
    assert '80 x 64' in bench.table(measured)
    assert [(one.width, one.height) for one in scene.BENCH.cases(True)['cases']] == [
        (320, 256), (640, 512)]
