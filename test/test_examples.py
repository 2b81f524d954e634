"""The examples run as scripts, find what they put in and draw their picture."""

import importlib.util
from pathlib import Path
import re
import subprocess
import sys

import numpy as np

from track_before_detect.simulation.scenarios import simulate

EXAMPLES = Path(__file__).parents[1] / 'examples'


def printed_by(name, folder, *arguments):
    done = subprocess.run([sys.executable, str(EXAMPLES / f'{name}.py'), *arguments], cwd=folder,
                          capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    if importlib.util.find_spec('matplotlib'):
        assert (folder / f'{name}.png').read_bytes().startswith(b'\x89PNG')
    return done.stdout


def numbers(pattern, text):
    """Return the groups of every match as numbers, shape (matches, groups)."""
    return np.array([match.groups() for match in re.finditer(pattern, text)], float)


def test_every_example_is_run_here_and_made_of_cells():
    names = {path.stem for path in EXAMPLES.glob('*.py')}
    assert names == {'simulated_drones', 'your_own_recording', 'range_doppler', 'several_sensors'}
    for name in names:
        lines = (EXAMPLES / f'{name}.py').read_text(encoding='utf-8').splitlines()
        assert 30 <= len(lines) <= 60
        assert sum(line.startswith('# %% ') for line in lines) >= 4


def test_simulated_drones_are_found(tmp_path):
    found = numbers(r'is drone (\d): .* (\d+) frames, .*error ([\d.]+) px',
                    printed_by('simulated_drones', tmp_path))
    assert sorted(found[:, 0]) == [0, 1, 2]
    assert (found[:, 1] >= 38).all()
    assert (found[:, 2] < 0.5).all()


def test_a_recording_made_by_the_example_is_searched(tmp_path):
    text = printed_by('your_own_recording', tmp_path)
    found = numbers(r'from frame 0 at x = ([\d.]+), y = ([\d.]+)', text)
    truth = numbers(r'truth begins at x = ([\d.]+), y = ([\d.]+)', text)
    assert found.shape == (1, 2)
    np.testing.assert_allclose(found, truth, atol=1.5)
    assert len((tmp_path / 'trajectories.csv').read_text().splitlines()) == 31


def test_a_recording_that_is_given_is_searched(tmp_path):
    own = simulate('maneuver', seed=8, height=64, width=72, snr=8.0)
    np.savez(tmp_path / 'own.npz', frames=own.frames, stamps=own.stamps)
    text = printed_by('your_own_recording', tmp_path, 'own.npz')
    assert 'own.npz: 30 frames of 72 x 64 pixels, float32' in text
    found = numbers(r'from frame 0 at x = ([\d.]+), y = ([\d.]+)', text)
    np.testing.assert_allclose(found, own.truth[:1, 2:], atol=1.5)
    assert 'truth' not in text


def test_range_doppler_targets_are_found_and_move_as_their_doppler_says(tmp_path):
    text = printed_by('range_doppler', tmp_path)
    found = numbers(r'from range bin ([\d.]+), Doppler bin ([\d.]+); moves ([-+.\d]+) range '
                    r'bins/s, its Doppler says ([-+.\d]+)', text)
    truth = numbers(r'truth of target \d: from range bin ([\d.]+), Doppler bin ([\d.]+)', text)
    np.testing.assert_allclose(np.sort(found[:, :2], axis=0), np.sort(truth, axis=0), atol=1.0)
    np.testing.assert_allclose(found[:, 2], found[:, 3], atol=0.05)
    assert (np.abs(found[:, 2]) > 7).all()


def test_several_sensors_find_what_none_finds_alone(tmp_path):
    text = printed_by('several_sensors', tmp_path)
    assert 'first: 0 found' in text and 'second: 0 found' in text and 'both: 1 found' in text
    assert numbers(r'error ([\d.]+) px', text).item() < 0.5
    np.testing.assert_allclose(numbers(r'velocity \[ *([-.\d]+) +([-.\d]+)\]', text),
                               [[1.4, -0.8]], atol=0.15)
