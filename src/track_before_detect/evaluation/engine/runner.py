"""Carries out the runs of a study, and knows the thresholds that they need."""

from track_before_detect.evaluation.engine.detectors import detector_of, Options, stamps_of
from track_before_detect.runs import runner


class Runner(runner.Runner):
    """Carries out the runs of a study; see :class:`track_before_detect.runs.runner.Runner`."""

    def threshold(self, options: Options, shape: tuple[int, ...]) -> float:
        """Return the threshold of a detector for batches of ``shape`` (T, H, W)."""
        n_frames, height, width = shape
        return detector_of(options).threshold(
            stamps_of(n_frames), (height, width), self.progress)
