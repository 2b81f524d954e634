"""Two trajectories in a small recording."""

import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.found import Found
from track_before_detect.types import DetectionResult, Trajectory


def trajectory(number, positions, first_frame=0, **values):
    positions = np.asarray(positions, np.float64)
    n_frames = len(positions)
    frames = first_frame + np.arange(n_frames)
    given = {'amplitudes': np.full(n_frames, 3.5), 'velocity': np.full((n_frames, 2), 2.0),
             'stamps': 0.25 * frames, 'statistic': 12.0, 'snr': 4.25, **values}
    given['velocity'][np.isnan(positions)] = np.nan
    return Trajectory(number, positions, frame_indices=frames, **given)


class Noise:
    """Frames of noise."""

    def read(self, index):
        return np.random.default_rng(index).normal(100, 20, (24, 40))

    def close(self):
        pass


@pytest.fixture
def found():
    lost = trajectory(7, [(3.25, 4.5), (np.nan, np.nan), (5.5, 6.0)], first_frame=2)
    once = trajectory(2, [(10.0, 0.0)], first_frame=5, snr=np.float64(9.0))
    result = DetectionResult([lost, once], threshold=8.0)
    recording = Recording('a.npz', (24, 40), np.float64, 6, Noise(), 0.25 * np.arange(6))
    return Found(recording, DetectorOptions(psf_sigma_px=1.5), result)
