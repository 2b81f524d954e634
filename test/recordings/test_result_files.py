import csv
import dataclasses
import json
import math
import os
from pathlib import Path
import tempfile

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.atomic_files import atomic_path
from track_before_detect.errors import DataError
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.result_files import (
    CSV_COLUMNS,
    read_trajectories_csv,
    write_summary_json,
    write_trajectories_csv,
)
from track_before_detect.types import Trajectory


def trajectory(number, present, seed=0, first_frame=0, complex_amplitude=False):
    rng = np.random.default_rng(seed)
    n_frames = len(present)
    absent = ~np.asarray(present, bool)
    positions = rng.uniform(-5, 2000, (n_frames, 2))
    velocity = rng.normal(0, 50, (n_frames, 2))
    amplitudes = rng.normal(9, 3, n_frames) * (1j if complex_amplitude else 1.0)
    for values in (positions, velocity, amplitudes):
        values[absent] = np.nan
    frames = first_frame + np.arange(n_frames)
    return Trajectory(number, positions, amplitudes, velocity, 1.7e9 + 0.04 * frames, frames,
                      statistic=11.25, snr=2.5)


def read_csv(path):
    with open(path, newline='') as file:
        return list(csv.DictReader(file))


@settings(deadline=None)
@given(st.lists(st.lists(st.booleans(), min_size=1, max_size=8), max_size=4),
       st.integers(0, 10**6))
def test_csv_has_one_row_per_presence_and_no_nan(presences, first_frame):
    trajectories = [trajectory(k + 1, present, k, first_frame)
                    for k, present in enumerate(presences)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'trajectories.csv'
        write_trajectories_csv(path, trajectories)
        text = path.read_text()
        rows = read_csv(path)
        again = Path(folder) / 'again.csv'
        write_trajectories_csv(again, read_trajectories_csv(path))
        assert again.read_text() == text
    assert text.splitlines()[0] == ','.join(CSV_COLUMNS)
    assert 'nan' not in text
    expected = [(t, k) for t in trajectories for k in np.flatnonzero(np.isfinite(t.amplitudes))]
    assert len(rows) == len(expected)
    for row, (t, k) in zip(rows, expected, strict=True):
        assert (int(row['trajectory_id']), int(row['frame'])) == (t.id, t.frame_indices[k])
        assert float(row['stamp_s']) == pytest.approx(t.stamps[k], abs=1e-6)
        assert float(row['x_px']) == pytest.approx(t.positions[k, 0], abs=5.1e-4)
        assert float(row['y_px']) == pytest.approx(t.positions[k, 1], abs=5.1e-4)
        assert float(row['vx_px_s']) == pytest.approx(t.velocity[k, 0], abs=5.1e-5)
        assert float(row['vy_px_s']) == pytest.approx(t.velocity[k, 1], abs=5.1e-5)
        assert float(row['amplitude']) == pytest.approx(abs(t.amplitudes[k]), rel=1e-5)
        assert (float(row['snr']), float(row['statistic'])) == (2.5, 11.25)


@pytest.mark.parametrize(('text', 'fragment'), [
    (None, 'cannot be read'), ('', 'the header names no amplitude'), ('a,b\n1,2\n', 'names no'),
    (','.join(CSV_COLUMNS) + '\n1,one' + ',0' * 11 + '\n', "'one'"),
    (','.join(CSV_COLUMNS) + '\n1,1\n', 'must hold the trajectories')])
def test_a_table_of_something_else_is_refused_with_its_name(tmp_path, text, fragment):
    path = tmp_path / 'trajectories.csv'
    if text is not None:
        path.write_text(text)
    with pytest.raises(DataError, match=fragment) as caught:
        read_trajectories_csv(path)
    assert str(path) in str(caught.value)


def test_csv_columns_are_those_of_the_contract():
    assert ','.join(CSV_COLUMNS) == (
        'trajectory_id,frame,stamp_s,x_px,y_px,vx_px_s,vy_px_s,amplitude,snr,statistic,'
        'var_x_px2,cov_xy_px2,var_y_px2')


def test_csv_without_trajectories_is_the_header_alone(tmp_path):
    write_trajectories_csv(tmp_path / 'a.csv', [])
    assert (tmp_path / 'a.csv').read_text() == ','.join(CSV_COLUMNS) + '\n'


def test_unknown_velocity_is_left_empty_and_complex_amplitude_is_its_magnitude(tmp_path):
    one = trajectory(1, [True], complex_amplitude=True)
    one.velocity[:] = np.nan
    write_trajectories_csv(tmp_path / 'a.csv', [one])
    row, = read_csv(tmp_path / 'a.csv')
    assert (row['vx_px_s'], row['vy_px_s']) == ('', '')
    assert float(row['amplitude']) == pytest.approx(abs(one.amplitudes[0]), rel=1e-5)


def test_covariance_is_written_where_it_is_known(tmp_path):
    known = np.array([[[0.25, -0.125], [-0.125, 0.5]], [[np.nan, np.nan], [np.nan, np.nan]]])
    one = dataclasses.replace(trajectory(1, [True, True]), covariance=known)
    write_trajectories_csv(tmp_path / 'a.csv', [one])
    rows = [[row[name] for name in ('var_x_px2', 'cov_xy_px2', 'var_y_px2')]
            for row in read_csv(tmp_path / 'a.csv')]
    assert rows == [['0.25', '-0.125', '0.5'], ['', '', '']]


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text()
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=8)


@settings(deadline=None, max_examples=40)
@given(st.dictionaries(st.text(), JSON_VALUES))
def test_summary_reads_back(mapping):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'a.json'
        write_summary_json(path, mapping)
        assert json.loads(path.read_text(encoding='utf-8')) == mapping


def test_summary_takes_numpy_and_writes_null_for_what_is_not_finite(tmp_path):
    path = tmp_path / 'a.json'
    write_summary_json(path, {
        'a': np.float32(0.5), 'b': np.int64(3), 'c': np.array([1.0, np.nan]), 'd': (math.inf,),
        'e': np.bool_(True), 'f': Path('x')})
    assert json.loads(path.read_text()) == {
        'a': 0.5, 'b': 3, 'c': [1.0, None], 'd': [None], 'e': True, 'f': 'x'}


def test_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_text('old')
    broken = object()
    with pytest.raises(AttributeError):
        write_trajectories_csv(path, [trajectory(1, [True]), broken])
    with pytest.raises(KeyboardInterrupt):
        with atomic_path(path) as partial:
            partial.write_text('half')
            raise KeyboardInterrupt
    assert path.read_text() == 'old'
    assert os.listdir(tmp_path) == ['a.csv']


def test_recording_is_written_whole_or_not_at_all(tmp_path):
    with pytest.raises(ValueError):
        write_npz_recording(tmp_path / 'a.npz', [[1, 2], [3]], [0.0])
    assert os.listdir(tmp_path) == []
