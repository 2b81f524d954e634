"""Every detector by its name: in Python, on the command line, with one type of result."""

import csv
import dataclasses
import json

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.cli import main
from track_before_detect.options import DETECTORS
from track_before_detect.simulation.sensor import add_target

PATH = np.array([[12 + 0.8 * t, 20 - 0.4 * t] for t in range(12)])

def frames_with_a_target(phases=None):
    rng = np.random.default_rng(4)
    clean = np.zeros((len(PATH), 40, 48), np.float32)
    for frame, (x, y) in zip(clean, PATH, strict=True):
        add_target(frame, x, y, 1.0, 12.0)
    if phases is None:
        return clean + rng.standard_normal(clean.shape)
    noise = rng.standard_normal((2, *clean.shape)) / np.sqrt(2)
    return clean * np.exp(1j * phases)[:, None, None] + noise[0] + 1j * noise[1]


@pytest.mark.parametrize('detector', DETECTORS)
def test_result_is_of_the_same_type(detector):
    result = tbd.detect(frames_with_a_target(), detector=detector, threshold=20.0)
    assert type(result) is tbd.DetectionResult and result.threshold == 20.0
    assert result.status == 'converged'
    [found] = result.trajectories
    [reference] = tbd.detect(frames_with_a_target(), threshold=20.0).trajectories
    for field in dataclasses.fields(reference):
        value, wanted = (np.asarray(getattr(one, field.name)) for one in (found, reference))
        assert value.shape == wanted.shape and value.dtype.kind == wanted.dtype.kind, field.name
    assert np.nanmean(np.linalg.norm(found.positions - PATH, axis=1)) < 0.8
    # Dynamic programming over whole pixels sees less of a target between them.
    assert found.statistic > 20 and found.snr == pytest.approx(12, rel=0.2)
    assert np.nanmean(found.amplitudes) == pytest.approx(12, rel=0.2)


@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_frames_without_data_have_no_amplitude_and_take_nothing_off_the_snr(detector):
    frames = frames_with_a_target()
    hidden = np.array([2, 3, 6])
    frames[hidden] = np.nan
    [found] = tbd.detect(frames, detector=detector, threshold=20.0).trajectories
    assert np.isnan(found.amplitudes[hidden]).all()
    shown = np.setdiff1d(np.flatnonzero(np.isfinite(found.positions[:, 0])), hidden)
    assert len(shown) > 0.6 * len(frames) and np.isfinite(found.amplitudes[shown]).all()
    assert np.mean(found.amplitudes[shown]) == pytest.approx(12, rel=0.2)
    assert found.snr == pytest.approx(12, rel=0.2)


@pytest.mark.parametrize('detector', ['convex', 'greedy', 'mt_dp', 'pc_dp', 'velocity_filter'])
@pytest.mark.parametrize('rectified', [False, True])
def test_amplitude_in_frames_of_one_row_is_that_of_the_row(detector, rectified):
    frames = np.zeros((8, 1, 64))
    for t in range(8):
        row = np.exp(-0.125 * (np.arange(64) - 20 - t)**2)
        frames[t, 0] = 9 * row / np.linalg.norm(row)
    if rectified:
        frames = frames.transpose(0, 2, 1)
    [found] = tbd.detect(frames, detector=detector, psf_sigma_px=2.0, threshold=12.0).trajectories
    np.testing.assert_allclose(found.amplitudes, 9.0, rtol=0.07)
    assert found.snr == pytest.approx(9.0, rel=0.05)


@pytest.mark.parametrize('detector', DETECTORS)
def test_command_line_takes_the_name(detector, tmp_path):
    np.savez(tmp_path / 'frames.npz', frames=frames_with_a_target())
    found = tmp_path / 'found'
    assert main(['detect', str(tmp_path / 'frames.npz'), '--detector', detector, '--set',
                 'threshold=20', '--output', str(found)]) == 0
    with open(found / 'trajectories.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert len({row['trajectory_id'] for row in rows}) == 1
    assert abs(float(rows[-1]['x_px']) - PATH[int(rows[-1]['frame'])][0]) < 1.5
    assert f'"{detector}"' in json.dumps(json.loads((found / 'summary.json').read_text()))


@pytest.mark.parametrize('amplitude_model', ['fluctuating', 'constant'])
@pytest.mark.parametrize('detector', ['convex', 'greedy', 'mt_dp', 'pc_dp'])
def test_complex_frames_are_searched_in_any_phase(detector, amplitude_model):
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, len(PATH))
    [found] = tbd.detect(frames_with_a_target(phases), detector=detector, amplitudes='complex',
                         amplitude_model=amplitude_model, threshold=20.0).trajectories
    assert np.nanmean(np.linalg.norm(found.positions - PATH, axis=1)) < 0.8
    assert np.abs(found.amplitudes).mean() == pytest.approx(12, rel=0.2)
    turned = np.angle(found.amplitudes * np.exp(-1j * phases))
    assert np.abs(turned).max() < 0.6
