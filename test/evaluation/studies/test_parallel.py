import numpy as np
import pytest

from canned import Canned
from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.studies.parallel import runs as parallel_runs
from track_before_detect.evaluation.studies.parallel import scenes
from track_before_detect.evaluation.studies.parallel.suite import run_parallel
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.cancellation.target_cancellation import Track


def answer(detected, error, candidates):
    return {'detected': [detected] * 6, 'squared_error': [error if detected else None] * 6,
            'n_tracks': 6, 'found': [2] * len(candidates), 'candidates': candidates}


def test_report_compares_the_methods_run_by_run(tmp_path):
    """Let pc_dp find every target, and mt_dp every second time with twice the error."""
    pytest.importorskip('matplotlib')
    result = run_parallel(20, 3, Canned(answers={
        'six_targets': lambda item: {'mt_dp': answer(item['seed'] % 2 == 0, 4.0, [1000]),
                                     'pc_dp': answer(True, 1.0, [200, 250, 150, 100])},
        'noise': lambda item: {'mt_dp': True, 'pc_dp': False}}))
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


def test_tracks_are_compared_with_the_cells_of_targets():
    # Target 1 ends at x = 18.1, in cell 18: cell 16 is two cells away, cell 15 is not.
    cells = scenes.six_targets(9.0, np.random.default_rng(1)).cells
    detected = []
    for end in (16, 15):
        pixels = np.column_stack([np.full(6, end), np.full(6, 33)])
        found = parallel_runs.outcome([Track(pixels, np.ones(6), 1.0)], cells)
        detected.append(found['detected'][:2])
        assert [error is not None for error in found['squared_error'][:2]] == detected[-1]
    assert detected == [[True, False], [False, False]]


def test_bright_targets_are_detected_by_both_methods():
    item = {'snr_db': 22.0, 'seed': 4, 'thresholds': {'mt_dp': 9.0, 'pc_dp': 9.0}}
    for found in parallel_runs.six_targets(item).values():
        assert found['detected'] == [True] * 6
        assert np.sqrt(np.mean(found['squared_error'])) < 1.0
        assert len(found['found']) == len(found['candidates'])
    assert parallel_runs.noise({'seed': 1, 'thresholds': {'mt_dp': 99.0, 'pc_dp': 99.0}}) == {
        'mt_dp': False, 'pc_dp': False}


def test_six_targets_are_where_the_paper_puts_them():
    scene = scenes.six_targets(8.0, np.random.default_rng(0))
    assert scene.frames.shape == (6, 50, 50) and scene.cells.shape == (6, 6, 2)
    np.testing.assert_allclose(scene.positions[:, 0, 0], [13.1, 20.1, 10.1, 30.1, 30.1, 35.1])
    np.testing.assert_allclose(scene.positions[:, -1] - scene.positions[:, 0],
                               5 * np.array([[1, 0.9], [-1, 1], [1, 0.9], [1, 0], [1, 0],
                                             [-0.9, 1]]))


def test_process_noise_has_the_covariance_of_the_paper():
    rng = np.random.default_rng(1)
    moved = np.array([scenes.moved(np.zeros((1, 4)), rng, 0.3)[0, 1]
                      for _ in range(4000)])
    np.testing.assert_allclose(np.cov(moved.T), 0.3 / 3 * np.eye(2), atol=0.01)


def test_power_of_a_target_and_of_the_noise_are_as_stated():
    rng = np.random.default_rng(2)
    noise = noise_frames(rng, (6, 200, 200), True)
    assert np.mean(np.abs(noise)**2) == pytest.approx(1, abs=0.02)
    scene = scenes.draw_scene([(25.0, 0.0, 25.0, 0.0)] * 1, 60.0, rng)
    assert np.abs(scene.frames[:, 25, 25])**2 == pytest.approx(1e6, rel=0.02)
