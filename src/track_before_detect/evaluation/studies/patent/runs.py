"""Single runs of the suite ``patent``."""

from collections.abc import Mapping
import functools
import json
import time
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.detectors import search
from track_before_detect.evaluation.studies.patent.figures import FIGURES

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
    results = {}
    for name, options in item['options'].items():
        _warm_up(item['figure'], json.dumps(options))
        began = time.process_time()
        result = search(options, scene.measured)
        results[name] = {
            'cpu_s': time.process_time() - began, 'status': result.status,
            'found': [path.positions[:, 0].tolist() for path in result.found],
            'amplitudes': [path.amplitudes.tolist() for path in result.found]}
    return results


@functools.lru_cache(maxsize=64)
def _warm_up(number: int, options: str) -> None:
    """Let a detector compile, and make its tables for scenes of the figure."""
    search(json.loads(options), _FIGURES[number].make(np.random.default_rng(0)).measured)
