"""What was found in a recording."""

from dataclasses import dataclass

from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.recording import Recording
from track_before_detect.types import DetectionResult


@dataclass(frozen=True)
class Found:
    """A recording that was searched, the options it was searched with, and the result."""

    recording: Recording
    options: DetectorOptions
    result: DetectionResult
