"""Single runs of the suite ``patent``."""

from __future__ import annotations

from collections.abc import Mapping
import functools
import json
import time
from typing import Any

import numpy as np

from track_before_detect.evaluation.studies.patent.scenes import FIGURES
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import BatchDetector
from track_before_detect.tracking.pipeline import DETECTOR_CLASSES
from track_before_detect.types import FrameBatch

_FIGURES = {figure.number: figure for figure in FIGURES}


def measure(item: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Search one scene by each method.

    Parameters
    ----------
    item : mapping
        ``figure`` (its number), ``seed`` and ``options`` by method, with a threshold.

    Returns
    -------
    dict
        By method: positions ``found`` (K, T), ``amplitudes`` (K, T), ``status`` and ``cpu_s``.
    """
    scene = _FIGURES[item['figure']].make(np.random.default_rng(item['seed']))
    stamps = np.arange(float(len(scene.measured)))
    results = {}
    for name, options in item['options'].items():
        detector = _warm_detector(item['figure'], json.dumps(options))
        began = time.process_time()
        result = detector.detect(FrameBatch.of(scene.measured, stamps))
        results[name] = {
            'cpu_s': time.process_time() - began, 'status': result.status,
            'found': [path.positions[:, 0].tolist() for path in result.found],
            'amplitudes': [path.amplitudes.tolist() for path in result.found]}
    return results


@functools.lru_cache(maxsize=64)
def _warm_detector(number, options) -> BatchDetector:
    """Return a detector that has compiled and searched a scene of the figure."""
    made = DetectorOptions.from_mapping(json.loads(options))
    detector = DETECTOR_CLASSES[made.detector](made)
    frames = _FIGURES[number].make(np.random.default_rng(0)).measured
    detector.detect(FrameBatch.of(frames, np.arange(float(len(frames)))))
    return detector
