import csv
import json

import numpy as np
import pytest

from canned import quiet
from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.detection.suite import run_detection
from track_before_detect.evaluation.studies.registry import suite_named, SUITES
from track_before_detect.simulation.scenarios import simulate

TINY = {'height': 40, 'width': 44, 'n_frames': 6, 'speed_px_per_frame': 0.5, 'snr': 8.0}


@pytest.fixture(scope='module')
def result():
    return run_detection(3, 5, Runner(quiet), **TINY)


def by_name(result):
    return {quantity.name: quantity for quantity in result.quantities}


def test_bright_targets_are_all_found_within_their_accuracy(result):
    quantities = by_name(result)
    found = quantities['targets found']
    assert (found.value, found.trials, found.high) == (1.0, 9, 1.0)
    rmse = quantities['position RMSE of found targets']
    assert 0.0 < rmse.low <= rmse.value <= rmse.high < 0.5


def test_there_is_one_row_per_run_and_twice_as_many_of_noise(result):
    scenarios = [row['scenario'] for row in result.rows]
    assert scenarios == ['three_targets'] * 3 + ['noise'] * 6
    assert len({row['seed'] for row in result.rows}) == 9
    assert all(row['cpu_s'] > 0 for row in result.rows)


def test_noise_passes_the_threshold_where_a_trajectory_was_reported(result):
    for row in result.rows:
        assert (row['largest_statistic'] > row['threshold']) == (
            row['n_found'] + row['n_false'] > 0)


def test_seed_decides_the_recordings_and_the_findings(result):
    def findings(rows):
        return [{key: value for key, value in row.items() if not key.endswith('_s')}
                for row in rows if row['scenario'] == 'three_targets']

    again = run_detection(2, 5, Runner(quiet), **TINY)
    other = run_detection(2, 6, Runner(quiet), **TINY)
    assert findings(again.rows) == findings(result.rows)[:2]
    assert findings(other.rows) != findings(again.rows)


def test_seed_of_a_row_makes_its_recording_again(result):
    seed = result.rows[0]['seed']
    assert seed == int(float(seed))
    assert len(np.unique(simulate('three_targets', seed, **TINY).truth[:, 1])) == 3


def test_dark_targets_leave_the_error_open():
    quantities = by_name(run_detection(1, 0, Runner(quiet), **{**TINY, 'snr': 0.0}))
    assert quantities['targets found'].value == 0.0
    assert np.isnan(quantities['position RMSE of found targets'].value)


def test_files_agree_with_the_result(result, tmp_path):
    pytest.importorskip('matplotlib')
    image = pytest.importorskip('matplotlib.image')
    written = write_suite_result(tmp_path / 'deep', 'detection', result, 'tbd evaluate x')
    assert sorted(path.name for path in written) == sorted(
        path.name for path in (tmp_path / 'deep').iterdir()) == [
            'detection.csv', 'detection.png', 'report.md', 'summary.json']
    with open(tmp_path / 'deep' / 'detection.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert [int(row['seed']) for row in rows] == [row['seed'] for row in result.rows]
    # An error of no target is no number.
    assert rows[-1]['rmse_px'] == '' and float(rows[0]['rmse_px']) > 0
    summary = json.loads((tmp_path / 'deep' / 'summary.json').read_text())
    assert summary['command'] == 'tbd evaluate x'
    assert summary['settings']['scenario']['height'] == 40
    assert [quantity['name'] for quantity in summary['quantities']] == list(by_name(result))
    report = (tmp_path / 'deep' / 'report.md').read_text()
    assert '`tbd evaluate x`' in report and 'requested: 5 %' in report
    table = [line for line in report.splitlines() if line.startswith('|')]
    assert len(table) == 2 + len(result.quantities)
    assert {line.count('|') for line in table} == {6}
    assert image.imread(tmp_path / 'deep' / 'detection.png').std() > 0


def test_picture_that_fails_leaves_the_files_of_the_run_before(result, tmp_path):
    pytest.importorskip('matplotlib')
    write_suite_result(tmp_path, 'detection', result, 'first')
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def draw(_):
        raise OSError(28, 'No space left on device')

    broken = type(result)(**{**vars(result), 'draw': draw})
    with pytest.raises(OSError, match='No space'):
        write_suite_result(tmp_path, 'detection', broken, 'second')
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize('suite', SUITES)
@pytest.mark.parametrize(('runs', 'seed', 'said'), [
    (0, 0, 'runs must be at least 1, got 0'), (1, -1, 'seed must not be negative, got -1')])
def test_runs_and_seeds_that_no_study_can_be_made_with_are_refused(suite, runs, seed, said):
    with pytest.raises(ParameterError, match=said):
        SUITES[suite].run(runs, seed, Runner(quiet))


def test_scene_without_targets_is_refused():
    with pytest.raises(ParameterError, match='n_targets must be at least 1, got 0'):
        run_detection(1, 0, Runner(quiet), n_targets=0)


def test_unknown_suite_is_told_the_nearest():
    assert suite_named('detection') is SUITES['detection']
    with pytest.raises(ParameterError, match='did you mean detection'):
        suite_named('detecton')
