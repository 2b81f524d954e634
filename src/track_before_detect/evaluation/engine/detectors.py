"""The detectors that studies search with, made of options that JSON can hold."""

from collections.abc import Mapping
import functools
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchDetector, BatchResult
from track_before_detect.solvers.detectors import make_detector
from track_before_detect.types import FrameBatch

Options = Mapping[str, Any]


def detector_of(options: Options) -> BatchDetector:
    """Return a new detector, or say what is wrong with its options."""
    return make_detector(DetectorOptions.from_mapping(dict(options)))


def search(options: Options, frames: NDArray) -> BatchResult:
    """Return what a detector finds in frames (T, H, W), one second from each to the next.

    A worker keeps its detectors, with their tables, for the runs that follow.
    """
    return _kept_detector(json.dumps(options, sort_keys=True)).detect(
        FrameBatch.of(frames, stamps_of(len(frames))))


def stamps_of(n_frames: int) -> NDArray[np.float64]:
    """Return the stamps of all studies, in seconds."""
    return np.arange(float(n_frames))


@functools.lru_cache(maxsize=64)
def _kept_detector(options: str) -> BatchDetector:
    return detector_of(json.loads(options))
