"""The suite ``real`` on recordings made here."""

import math

import numpy as np
import pytest

from canned import Canned
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.evaluation.engine.report import write_suite_result
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.studies.real import runs as real_runs
from track_before_detect.evaluation.studies.real.methods import (
    METHODS,
    methods_and_peers,
    options_of,
)
from track_before_detect.evaluation.studies.real.suite import run_real
from track_before_detect.options import DETECTORS

# Without the noise in its units nearly all of what is added would pass.
OURS = {'threshold': 20.0, 'noise': 'robust', 'batch_length': 8, 'hop': 4}
N_FRAMES = 12


class Frames(list):
    stamps = np.arange(20.0)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with a recording: a bright target that crosses unit noise."""
    folder = tmp_path_factory.mktemp('data')
    frames = np.random.default_rng(3).normal(size=(N_FRAMES, 40, 50))
    row, column = np.indices(frames.shape[1:])
    truth = np.array([[k, 0, 10 + 0.5 * k, 20] for k in range(N_FRAMES)])
    for k, _, x, y in truth:
        frames[int(k)] += 30 * np.exp(-((column - x)**2 + (row - y)**2) / 2)
    np.savez(folder / 'one.npz', frames=frames, truth=truth, fps=10.0)
    return folder


def item(folder, **changes):
    return {'data': str(folder), 'recording': 'one', 'method': 'ours', 'options': OURS,
            'snr': None, 'seed': 0, 'time_limit_s': 300.0, **changes}


def test_every_method_has_options_that_can_be_used():
    rng = np.random.default_rng(0)
    for frames in (rng.normal(size=(20, 40, 50)), 8000 + 20 * rng.normal(size=(20, 40, 50))):
        used = {name: options_of(method, Frames(frames)) for name, method in METHODS.items()}
        assert {name: options.detector for name, options in used.items()} == {
            'auto': 'convex', **{name: name for name in DETECTORS[1:]}}
        prepared = {(options.background, options.registration, options.noise)
                    for name, options in used.items() if name != 'auto'}
        assert len(prepared) == 1


def test_options_of_a_method_override_those_of_its_preset():
    pedestal = Frames(8000 + 20 * np.random.default_rng(0).normal(size=(20, 40, 50)))
    assert options_of({'preset': 'auto'}, pedestal).calibration == 'clutter'
    assert options_of({'preset': 'auto', 'calibration': 'noise'}, pedestal).noise == 'robust'
    assert options_of({}, pedestal).noise == 'none'


def test_a_bright_target_is_followed(folder):
    # Searched in a process of its own, as each run of the study is.
    row = real_runs.measure(item(folder))
    assert row['status'] == 'converged'
    assert (row['followed'], row['ids_per_target'], row['n_false']) == (1, 1, 0)
    assert (row['n_frames'], row['n_batches'], row['n_labels']) == (N_FRAMES, 2, N_FRAMES)
    assert (row['p_d'], row['f_a'], row['first_detection_frames']) == (1, 0, 0)
    assert row['rmse_px'] < 0.2
    assert 0 < row['seconds_per_frame'] < 10


def test_noise_is_added_until_the_target_is_as_dim_as_asked_for(folder):
    row = real_runs.search(item(folder, snr=4.0))
    assert row['sigma'] == pytest.approx(30 / 4, rel=0.15)
    assert row['status'] == 'converged'


def test_a_recording_that_is_dimmer_is_not_searched(folder):
    row = real_runs.search(item(folder, snr=100.0))
    assert row['status'] == real_runs.DIMMER
    assert math.isnan(row['followed'])


def test_a_method_that_refuses_has_found_nothing(folder):
    row = real_runs.search(item(folder, options={'no_such_option': 1}))
    assert row['status'].startswith('refused: ')
    assert row['followed'] == 0


def test_a_run_is_ended_in_time(folder):
    row = real_runs.measure(item(folder, time_limit_s=0.01))
    assert row['status'] == real_runs.NO_ANSWER
    assert (row['followed'], row['n_batches']) == (0, 0)


def test_a_run_that_breaks_says_why(folder):
    row = real_runs.measure(item(folder, recording='absent'))
    assert row['status'] == "failed: KeyError: 'absent'"


def test_the_suite_reports_every_method_and_snr(folder, tmp_path):
    pytest.importorskip('matplotlib')
    result = run_real(
        1, 5, Canned(answers={'measure': real_runs.search}), data=str(folder),
        methods={'ours': OURS, 'deaf': {**OURS, 'threshold': 1e9}}, snrs=(None, 4.0, 100.0))
    assert [(row['method'], row['snr']) for row in result.rows] == [
        (method, snr) for method in ('ours', 'deaf') for snr in (None, 4.0, 100.0)]
    values = {quantity.name: quantity for quantity in result.quantities}
    assert values['ours, as it is: frames followed'].value == 1
    assert values['ours, as it is: recordings followed in 90 % of their frames'].value == 1
    assert values['ours, as it is: false trajectories per batch'].trials == 2
    assert values['ours, SNR 4: frames followed'].trials == 1
    assert values['deaf, as it is: frames followed'].value == 0
    assert math.isnan(values['deaf, as it is: position RMSE'].value)
    # Recordings that are dimmer as they are say nothing about an SNR.
    assert not any('SNR 100' in name for name in values)
    written = write_suite_result(tmp_path / 'out', 'real', result, 'tbd evaluate real')
    report = (tmp_path / 'out' / 'report.md').read_text()
    assert '| one | 100.0 % | 0 | 1 | 0 |' in report
    assert '| archives | ours | 1 | 100 | 0 |' in report
    assert {path.name for path in written} == {
        'report.md', 'real.csv', 'real.png', 'summary.json'}


def test_methods_may_be_chosen_by_their_names():
    assert list(methods_and_peers(['pc_dp', 'auto'])) == ['pc_dp', 'auto']
    assert methods_and_peers(['auto']) == {'auto': METHODS['auto']}
    with pytest.raises(ParameterError, match="unknown method 'pc_d'; did you mean pc_dp"):
        methods_and_peers(['pc_d'])


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(DataError, match='holds no recording with truth'):
        run_real(1, 5, Runner(lambda *_: None), data=str(tmp_path))
