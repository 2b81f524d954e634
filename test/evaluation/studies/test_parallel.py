import numpy as np
import pytest

from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.parallel import (
    runs as parallel_runs,
)
from track_before_detect.evaluation.studies.parallel import (
    suite as parallel_suite,
)
from track_before_detect.solvers.cancellation.target_cancellation import Search, Track


def quiet(label, done):
    assert label and 0 <= done <= 1


class Uncalibrated:
    """Stands in for a detector whose threshold is asked for."""

    def __init__(self, options):
        pass

    def threshold(self, *_):
        return 5.0


def canned(detected, error, candidates):
    return {'detected': [detected] * 6, 'squared_error': [error if detected else None] * 6,
            'n_tracks': 6, 'found': [2] * len(candidates), 'candidates': candidates}


@pytest.fixture
def stand_ins(monkeypatch):
    """Let pc_dp find every target, and mt_dp every second time with twice the error."""
    monkeypatch.setattr(parallel_suite, 'METHODS', dict.fromkeys(('mt_dp', 'pc_dp'), Uncalibrated))
    monkeypatch.setattr(parallel_runs, 'options', lambda *_, **__: None)
    monkeypatch.setattr(parallel_runs, 'six_targets', lambda item: {
        'mt_dp': canned(item['seed'] % 2 == 0, 4.0, [1000]),
        'pc_dp': canned(True, 1.0, [200, 250, 150, 100])})
    monkeypatch.setattr(parallel_runs, 'noise', lambda item: {'mt_dp': True, 'pc_dp': False})


def test_report_compares_the_methods_run_by_run(stand_ins, tmp_path):
    pytest.importorskip('matplotlib')
    result = parallel_suite.run_parallel(20, 3, Runner(quiet))
    values = {quantity.name: quantity for quantity in result.quantities}
    gain = values['P_d of PC minus MT, all SNRs and targets']
    assert gain.low < gain.value < gain.high and 0.3 < gain.value < 0.7
    ratio = values['RMSE of PC over MT, 5 to 9 dB, targets 1 and 2']
    assert (ratio.low, ratio.value, ratio.high) == (0.5, 0.5, 0.5)
    assert values['candidates at 8 dB, slowest direction of PC over MT'].value == 0.25
    assert values['candidates at 8 dB, all directions of PC over MT'].value == pytest.approx(0.7)
    assert values['candidates at 8 dB, Eq. 18 with the targets found'].value == 0.25
    # Two found in all, two in the slowest direction, each with four of nine predecessors.
    assert values['candidates at 8 dB, the same with shared borders and the last search'
                  ].value == pytest.approx(4 / 9)
    assert values['noise batches with a track, mt_dp'].value == 1.0
    assert len(result.rows) == 2 * 20 * 12
    write_suite_result(tmp_path, 'parallel', result, 'the command')
    report = (tmp_path / 'report.md').read_text()
    assert '| 15 | ' in report and 'each has 0.444 of it' in report
    assert (tmp_path / 'parallel_rmse.png').stat().st_size > 10000


def test_tracks_are_compared_with_the_cells_of_targets(monkeypatch):
    # Target 1 ends at x = 18.1, in cell 18: cell 16 is two cells away, cell 15 is not.
    def track(end):
        pixels = np.column_stack([np.full(6, end), np.full(6, 33)])
        return [Track(pixels, np.ones(6), 1.0)], [Search([], 0.0, 1)]

    detected = []
    for end in (16, 15):
        monkeypatch.setattr(parallel_runs, '_search', lambda *_, end=end: track(end))
        item = {'snr_db': 9.0, 'seed': 1, 'thresholds': {'mt_dp': 5.0, 'pc_dp': 5.0}}
        detected.append(parallel_runs.six_targets(item)['pc_dp']['detected'][:2])
    assert detected == [[True, False], [False, False]]


def test_bright_targets_are_detected_by_both_methods():
    item = {'snr_db': 22.0, 'seed': 4, 'thresholds': {'mt_dp': 9.0, 'pc_dp': 9.0}}
    for found in parallel_runs.six_targets(item).values():
        assert found['detected'] == [True] * 6
        assert np.sqrt(np.mean(found['squared_error'])) < 1.0
        assert len(found['found']) == len(found['candidates'])
    assert parallel_runs.noise({'seed': 1, 'thresholds': {'mt_dp': 99.0, 'pc_dp': 99.0}}) == {
        'mt_dp': False, 'pc_dp': False}
