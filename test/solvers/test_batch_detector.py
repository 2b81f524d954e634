"""What the detectors of a batch share: graph, threshold and search."""

import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers import batch_detector as module
from track_before_detect.solvers.calibration.threshold import Calibration
from track_before_detect.solvers.convex.detector import ConvexDetector

REGULAR = 0.04 * np.arange(12)
GENERATOR = np.random.default_rng(1)


@pytest.mark.parametrize('stamps', [
    pytest.param(np.delete(0.04 * np.arange(13), 7), id='a lost frame'),
    pytest.param(REGULAR + GENERATOR.uniform(-0.008, 0.008, 12), id='jitter of 20 %'),
    pytest.param(1.05 * REGULAR, id='a clock that drifts'),
])
def test_irregular_stamps_share_the_calibration_of_regular_ones(stamps, monkeypatch):
    calls = []
    monkeypatch.setattr(
        module, 'calibrate', lambda *_: calls.append(1) or Calibration(8.0, 'simulated'))
    detector = ConvexDetector(DetectorOptions(max_speed_px_s=20))
    for batch in (REGULAR, stamps):
        assert detector.threshold(batch, (32, 32)) == 8.0
    assert len(calls) == 1


def test_other_lengths_shapes_and_rates_are_calibrated_anew(monkeypatch):
    calls = []
    monkeypatch.setattr(
        module, 'calibrate', lambda *_: calls.append(1) or Calibration(8.0, 'simulated'))
    detector = ConvexDetector(DetectorOptions(max_speed_px_s=20))
    detector.threshold(REGULAR, (32, 32))
    detector.threshold(REGULAR[:8], (32, 32))
    detector.threshold(REGULAR, (32, 48))
    detector.threshold(2 * REGULAR, (32, 32))
    assert len(calls) == 4
