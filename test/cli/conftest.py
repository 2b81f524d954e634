"""A small recording, and a stand-in for the detector."""

import dataclasses
import logging
import sys
import types

import numpy as np
import pytest

from track_before_detect.types import DetectionResult, Trajectory


@pytest.fixture(autouse=True)
def quiet_logging(monkeypatch):
    """Keep the command from configuring the logging of the tests."""
    monkeypatch.setattr(logging, 'basicConfig', lambda **_: None)


@pytest.fixture
def recording_file(tmp_path):
    path = tmp_path / 'a.npz'
    rng = np.random.default_rng(0)
    truth = [[k, 0, 5 + k, 6] for k in range(6)]
    np.savez(path, frames=rng.normal(size=(6, 16, 20)), fps=10, truth=truth)
    return path


@pytest.fixture
def stand_in(monkeypatch):
    """Replace the detector by one that reports what it was given; return the calls."""
    calls = types.SimpleNamespace(options=None, trajectories=2, error=None, rejected=())

    def detect_recording(recording, options, progress=None, reasons=(), over_all_frames=True):
        calls.options = options
        progress('calibrating', 0.0)
        progress('calibrating', 1.0)
        for _ in range(2):
            progress('calibrating', 1.0)
            progress('searching', 0.5)
        if calls.error is not None:
            raise calls.error
        n_frames = len(recording)
        positions = np.column_stack([5.0 + np.arange(n_frames), np.full(n_frames, 6.0)])
        positions[0] = np.nan
        velocity = np.where(np.isnan(positions), np.nan, (10.0, 0.0))
        found_as = Trajectory(1, positions, np.full(n_frames, 3.0), velocity, recording.stamps,
                              np.arange(n_frames), 12.345, 3.2)
        found = [dataclasses.replace(found_as, id=k + 1) for k in range(calls.trajectories)]
        rejected = [dataclasses.replace(found_as, id=0, statistic=statistic, reason=reason)
                    for statistic, reason in calls.rejected]
        return DetectionResult(found, 8.5, gap=float('nan'), remarks=list(reasons),
                               rejected=rejected)

    module = types.ModuleType('track_before_detect.tracking.recording')
    module.detect_recording = detect_recording
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return calls
