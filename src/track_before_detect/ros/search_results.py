"""What the search thread hands on: what was found in a batch, and where it is.

No ROS types in here.
"""

from dataclasses import dataclass, field
from typing import Any

from track_before_detect.options import DetectorOptions
from track_before_detect.types import DetectionResult, FrameBatch


@dataclass(frozen=True)
class StreamResult:
    """Trajectories of one batch.

    Attributes
    ----------
    detection : DetectionResult
        What was found in the batch.
    batch : FrameBatch
        The frames.
    tags : dict
        Frame index to the tag given at intake.
    interval_s : float
        Mean time between the frames of the batch, 0 when there is only one.
    hop : int
        Frames from this batch to the next.
    """

    detection: DetectionResult
    batch: FrameBatch
    tags: dict[int, Any]
    interval_s: float
    hop: int


@dataclass
class Status:
    """Where the worker is and what it searches with, for diagnostics.

    ``beside`` says how far the preparation of other options is while the search goes on.
    """

    state: str = 'waiting for frames'
    detail: str = ''
    beside: str = ''
    threshold: float = float('nan')
    processing_s: float = 0.0
    longest_processing_s: float = 0.0
    latency_s: float = 0.0
    shape: tuple[int, int] | None = None
    searching: bool = False
    preset: str = ''
    options: DetectorOptions = field(default_factory=DetectorOptions)
    reasons: list[str] = field(default_factory=list)
