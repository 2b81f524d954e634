import numpy as np
import pytest

from canned import Canned
from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.studies.ring import runs as ring_runs
from track_before_detect.evaluation.studies.ring.multi import run_ring_multi
from track_before_detect.evaluation.studies.ring.scenes import (
    point_frames,
    ring_multi,
    ring_single,
)
from track_before_detect.evaluation.studies.ring.shares import Shares
from track_before_detect.evaluation.studies.ring.single import run_ring_single
from track_before_detect.solvers.ring.merit_functions import METHODS


def test_targets_of_figure_7_meet_where_the_text_says():
    line_1, line_2, arc = ring_multi(3)
    np.testing.assert_allclose(line_1[30], [48, 52])
    np.testing.assert_allclose(line_2[30], [48, 52])
    meeting = np.linalg.norm(line_1 - arc, axis=1)
    assert meeting.argmin() == 54 and meeting.min() < 0.8
    np.testing.assert_allclose(line_1[53:55].mean(axis=0), [67, 66], atol=0.5)
    np.testing.assert_allclose(np.linalg.norm(arc - [64, 46], axis=1), 20)
    np.testing.assert_allclose(np.linalg.norm(np.diff(arc, axis=0), axis=1), 1, atol=2e-3)
    assert len(ring_multi(1)) == len(ring_multi(2)) == 2
    np.testing.assert_array_equal(ring_multi(2, 20, 30), ring_multi(2)[:, 30:50])


def test_targets_of_figure_5_stay_inside_and_the_arc_is_20_px_across():
    for case in (1, 2, 3):
        path = ring_single(case, 100)
        assert path.min() >= 0 and path.max() <= 127
    np.testing.assert_allclose(np.ptp(ring_single(3, 100), axis=0), 20, atol=0.1)
    np.testing.assert_array_equal(ring_single(1, 2), [[5, 10], [6.2, 11.1]])


def test_points_stand_out_of_unit_noise_where_they_are():
    targets = ring_multi(3, 20)
    frames = point_frames(np.random.default_rng(0), targets, 50.0, 128)
    x, y = np.rint(targets[0, 7]).astype(int)
    assert frames[7, y, x] > 40
    assert abs((frames > 25).sum() - 60) <= 1
    assert np.std(frames[frames < 25]) == pytest.approx(1, abs=0.02)


def test_bright_targets_are_found_everywhere_by_every_method():
    single = ring_runs.single({'case': 2, 'n_frames': 12, 'snr': 20.0, 'seed': 1})
    assert single == dict.fromkeys(METHODS, 12)
    multi = ring_runs.multi({'case': 1, 'n_frames': 30, 'snr': 20.0, 'seed': 1})
    assert all(detected >= 48 and false <= 6 for detected, false in multi.values())


def test_differences_are_taken_run_by_run():
    rng = np.random.default_rng(0)
    common = rng.uniform(0, 0.5, (1, 1, 1, 40, 1))
    table = Shares(common + 0.1 * np.arange(6))
    methods = list(METHODS)
    quantity = table.quantity('gain', lambda p: (p[methods[1]] - p[methods[0]]).mean())
    assert quantity.value == pytest.approx(0.1)
    assert quantity.high - quantity.low < 1e-9 and quantity.trials == 40
    alone = table.quantity('share', lambda p: p[methods[0]].mean())
    assert alone.low < alone.value < alone.high


@pytest.mark.parametrize(('name', 'run'), [('ring-single', run_ring_single),
                                           ('ring-multi', run_ring_multi)])
def test_reports_hold_every_point_and_what_the_paper_states(tmp_path, name, run):
    pytest.importorskip('matplotlib')
    result = run(2, 1, Canned(answers={
        'single': lambda item: dict.fromkeys(METHODS, item['seed'] % item['n_frames']),
        'multi': lambda item: dict.fromkeys(METHODS, [item['seed'] % 200, item['seed'] % 50])}))
    assert len(result.rows) == 2 * (54 if name == 'ring-single' else 12)
    assert all(quantity.note.startswith('paper: ') for quantity in result.quantities)
    write_suite_result(tmp_path, name, result, 'the command')
    report = (tmp_path / 'report.md').read_text()
    if name == 'ring-single':
        # Table 1: candidates beside each other.
        assert '| CFO | 1 | 9 |' in report and '| MFF | 2 | 165 |' in report
        assert report.count('\n| 20 | ') == 18
    else:
        assert '| MFF | 3 | ' in report and (tmp_path / 'ring-multi_false_alarms.png').exists()
