import dataclasses
import json
import os

import numpy as np
import pytest

from canned import quiet
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.evaluation.benchmarks import convex, dp, fit
from track_before_detect.evaluation.benchmarks.numpy_merit import numpy_merit_functions
from track_before_detect.evaluation.benchmarks.path_search import GRID_SHAPE, search_rows, SEARCHES
from track_before_detect.evaluation.benchmarks.registry import bench_named, BENCHES
from track_before_detect.evaluation.engine.machine import describe_machine
from track_before_detect.runs.own_process import in_own_process
from track_before_detect.solvers.ring.merit_functions import merit_functions

TINY = {'height': 40, 'width': 44, 'n_frames': 6, 'snr': 8.0}


@pytest.fixture(scope='module')
def measured():
    tiny = dataclasses.replace(convex.BENCH, cases=lambda large: {
        'cases': [convex.Case('tiny', 'single_target', TINY)], 'searches': []})
    return tiny.measure(3, False, quiet)


def test_every_stage_is_measured(measured):
    [case] = measured['cases']
    for stage in ('detection', 'matched_filter', 'path_search', 'layer_copy'):
        for clock in ('wall_s', 'cpu_s'):
            assert 0 <= case[stage][clock]['min'] <= case[stage][clock]['median']
        assert case[stage]['wall_s']['min'] > 0
    assert case['n_trajectories'] == 1
    assert case['peak_memory_bytes'] >= case['peak_memory_before_bytes'] > 10 * 2**20


def test_rates_and_ratios_agree_with_the_times(measured):
    [case] = measured['cases']
    seconds = case['path_search']['wall_s']['min']
    assert case['n_states'] == case['n_velocities'] * case['n_positions']
    n_weights = case['n_frames'] * case['n_states']
    assert case['score_volume_bytes'] == 4 * n_weights
    assert case['states_per_s'] == pytest.approx(n_weights / seconds)
    assert case['computed_states_per_s'] == pytest.approx(
        case['n_segments'] * case['n_states'] / seconds)
    copy = case['layer_copy']['wall_s']['min']
    for stage in ('detection', 'matched_filter', 'path_search'):
        assert case['over_volume_copy'][stage] == pytest.approx(
            case[stage]['wall_s']['min'] / (case['n_frames'] * copy))
    assert case['search_over_copy_of_computed']['of_minima'] == pytest.approx(
        seconds / (case['n_segments'] * copy))


def test_search_alone_is_measured_frame_by_frame_and_in_segments():
    searches = [dataclasses.replace(case, grid_shape=(20, 50)).measure_here(2)
                for case in SEARCHES]
    by_frame, by_segment = searches
    assert by_frame['n_segments'] == by_frame['n_frames'] and by_frame['n_velocities'] == 25
    assert by_segment['n_segments'] < by_segment['n_frames']
    for case in searches:
        assert case['states_per_s'] >= case['computed_states_per_s'] > 0
    assert all(case.grid_shape == GRID_SHAPE == (1024, 1280) for case in SEARCHES)
    assert all('0.00 M positions' in row for row in search_rows(searches))


def test_measurements_are_plain_numbers_and_make_a_table(measured):
    assert json.loads(json.dumps(measured)) == measured
    text = convex.BENCH.table(measured)
    assert '6 x 44 x 40' in text and 'tiny' in text
    assert describe_machine()['processor'] in text


def test_fit_of_all_constant_velocities_reaches_its_gap():
    measured = fit.BENCH.measure(2, False, quiet)
    assert json.loads(json.dumps(measured)) == measured
    assert measured['n_paths'] > 6000
    for case in measured['cases']:
        assert 0 <= case['gap'] <= 1e-6 * case['objective']
        assert case['n_used'] > 0 and case['fit']['cpu_s']['min'] > 0
    assert '7.5' in fit.BENCH.table(measured)


def test_machine_is_described_without_its_name():
    text = json.dumps(describe_machine())
    assert np.__version__ in text
    assert os.uname().nodename not in text.split('"')


def test_standard_cases_go_from_noise_to_a_crowd():
    small, both = (convex.cases(large)['cases'] for large in (False, True))
    assert [case.name for case in small] == [
        'noise', 'three targets, SNR 3', 'six targets, SNR 5', 'six targets, SNR 5',
        'fifty targets, SNR 5']
    assert both[:5] == small
    assert {(case.overrides['height'], case.overrides['width']) for case in both[5:]} == {
        (512, 640), (512, 512)}
    assert both[-1].overrides['n_targets'] == 200


def test_error_of_a_measurement_reaches_the_caller():
    with pytest.raises(ParameterError, match='did you mean noise'):
        convex.Case('wrong', 'nois').measure(1)


def test_measurement_that_the_system_ends_is_named():
    with pytest.raises(DataError, match=r'ended by the system \(exit code 9\)'):
        in_own_process(os._exit, 9)


@pytest.mark.parametrize('name', BENCHES)
def test_no_repeats_are_refused(name):
    with pytest.raises(ParameterError, match='repeats must be at least 1, got 0'):
        bench_named(name).measure(0, False, quiet)


def test_unknown_bench_is_told_the_nearest():
    with pytest.raises(ParameterError, match='did you mean convex'):
        bench_named('convx')


@pytest.mark.parametrize('order', dp.ORDERS)
@pytest.mark.parametrize('v_max', dp.SPEEDS)
def test_numpy_and_compiled_merit_functions_are_equal(order, v_max):
    frames = np.random.default_rng(1).standard_normal((9, 20, 23)).astype(np.float32)
    np.testing.assert_allclose(numpy_merit_functions(frames, order, v_max),
                               merit_functions(frames, f'{order}_dp', v_max), rtol=1e-5)


def test_dynamic_programming_is_measured_beside_numpy_and_the_paper():
    short = [dataclasses.replace(case, n_frames=4, n_frames_numpy=4)
             for case in dp.cases(False)['cases']]
    bench = dataclasses.replace(dp.BENCH, cases=lambda large: {'cases': short})
    measured = bench.measure(1, False, quiet)
    assert json.loads(json.dumps(measured)) == measured
    assert [(case['order'], case['n_candidates']) for case in measured['cases']] == [
        ('cfo', 9), ('cso', 49), ('mff', 49), ('cfo', 25), ('cso', 165), ('mff', 165)]
    for case in measured['cases']:
        assert [(one['method'][3:], one['threads']) for one in case['methods']] == [
            ('_dp', 1), ('_dp', 2), ('_dpr', 1), ('_dpr', 2)]
        assert all(one['per_frame']['wall_s']['min'] > 0 for one in case['methods'])
    text = bench.table(measured)
    assert 'mff_dpr' in text and '449' in text and describe_machine()['processor'] in text
