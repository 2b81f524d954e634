"""The suite ``real-alarms`` on recordings made here."""

import numpy as np
import pytest

from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.real import alarm_runs
from track_before_detect.evaluation.studies.real.alarms import Alarms, run_alarms
from track_before_detect.evaluation.studies.real.truth import Other, Truth

N_FRAMES = 24
RATES = [0.01, 0.2]


def moving(frames, x, y, step):
    """Add a bright target to frames; return its labels."""
    row, column = np.indices(frames.shape[1:])
    labels = np.array([[k, 0, x + step * k, y] for k in range(len(frames))])
    for k, _, at, _ in labels:
        frames[int(k)] += 200 * np.exp(-((column - at)**2 + (row - y)**2) / 2)
    return labels


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with two noisy scenes of one target, one with another without a label."""
    folder = tmp_path_factory.mktemp('data')
    for name in ('alone', 'two'):
        frames = 1000 + 10 * np.random.default_rng(5).normal(size=(N_FRAMES, 64, 80))
        truth = moving(frames, 20, 20, 1.0)
        if name == 'two':
            moving(frames, 60, 44, -1.0)
        np.savez(folder / f'{name}.npz', frames=frames, truth=truth, fps=10.0)
    return folder


@pytest.fixture(scope='module')
def result(folder):
    return run_alarms(1, 0, Runner(lambda *_: None), data=str(folder), rates=RATES)


def test_a_target_with_a_label_is_no_alarm_and_one_without_is(result):
    by_name = {name: [row for row in result.rows if row['recording'] == name]
               for name in ('alone', 'two')}
    assert [row['first_frame'] for row in by_name['alone']] == [0, 8]
    assert all(row['rate'] == alarm_runs.NO_ALARM for row in by_name['alone'])
    assert [row['rate'] for row in by_name['two']] == [0.01, 0.01]
    for row in by_name['two']:
        assert row['y'] == pytest.approx(44, abs=1)
        assert row['x'] == pytest.approx(60 - row['first_frame'] - 7.5, abs=1.5)


def test_the_report_has_all_together_and_each(result, tmp_path):
    pytest.importorskip('matplotlib')
    values = {quantity.name: quantity for quantity in result.quantities}
    together = values['all recordings, 1 % requested']
    assert (together.value, together.trials) == (0.5, 4)
    assert together.note == 'goal: 0.5 to 2 %'
    assert values['two, 20 % requested'].value == 1
    # Too few batches to be held to a factor.
    assert values['two, 20 % requested'].note == ''
    written = write_suite_result(tmp_path / 'out', 'real-alarms', result, 'tbd evaluate')
    assert {path.name for path in written} == {
        'report.md', 'real-alarms.csv', 'real-alarms.png', 'summary.json'}


def test_batches_that_share_frames_tell_less_than_as_many_that_do_not():
    low, high = Alarms([8], 80, 20).interval(0)
    assert (low, high) == Alarms([2], 20, 20).interval(0)
    narrow = Alarms([8], 80, 80).interval(0)
    assert low < narrow[0] < 0.1 < narrow[1] < high


def test_what_is_known_to_be_there_is_taken_out_where_it_is_in_any_frame():
    labels = np.array([[0, 0, 20, 30, 0, 0], [1, 0, 26, 30, 0, 0], [5, 0, 90, 90, 10, 4]])
    other = Other('a bird', ((1, 60, 10), (2, 60, 14)), (3, 2))
    truth = Truth.of_labels(labels, 6, others=[other])
    taken = alarm_runs.places_of(truth, np.array([0, 1, 2]), (100, 120), 5.0)
    assert np.argwhere(taken[:, :45]).min(axis=0).tolist() == [21, 11]
    assert np.argwhere(taken[:, :45]).max(axis=0).tolist() == [39, 35]
    assert np.argwhere(taken[:, 45:]).min(axis=0).tolist() == [3, 52 - 45]
    assert np.argwhere(taken[:, 45:]).max(axis=0).tolist() == [21, 68 - 45]
    later = alarm_runs.places_of(truth, np.array([5]), (100, 120), 5.0)
    assert later.sum() == (2 * 10 + 1) * (2 * 7 + 1)
