"""The strongest paths are those of the frames as they are after some pixels were set aside."""

import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.clutter.detector import ClutterDetector
from track_before_detect.solvers.clutter.strongest_paths import StrongestPaths
from track_before_detect.solvers.refine.refinement import refiner_for
from track_before_detect.types import FrameBatch


@pytest.mark.parametrize('signs', [(1,), (1, -1)])
def test_paths_have_their_values_in_the_frames_without_what_was_set_aside(signs):
    detector = ClutterDetector(DetectorOptions(calibration='clutter', max_speed_px_s=1.0))
    frames = np.random.default_rng(4).normal(size=(8, 90, 150)).astype(np.float32)
    task = detector.task(FrameBatch.of(frames, np.arange(8.0)), 1.0)
    refiner = refiner_for(task.targets)
    strongest = StrongestPaths(task, refiner, signs, 5.0)
    before = strongest.by_strength()
    middle, reach = before[0].positions, 9
    for frame, (x, y) in zip(strongest.frames, middle.astype(int), strict=True):
        frame[max(y - reach + 1, 0):y + reach, max(x - reach + 1, 0):x + reach] = 0
    strongest.without_touched(middle, reach)
    after = strongest.by_strength()
    assert len(after) > 40
    for path in after:
        value = refiner.value(path.sign * strongest.frames, path.positions, path.cost)
        assert path.value == pytest.approx(value, rel=1e-5)
        assert path.value < before[0].value
