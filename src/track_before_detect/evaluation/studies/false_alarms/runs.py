"""Single runs of the suite ``false-alarms``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.detectors import search
from track_before_detect.evaluation.studies.single_target import N_FRAMES, noise


def noise_alarms(item: Mapping[str, Any]) -> dict[str, list[bool]]:
    """Search one batch of noise at several thresholds.

    Parameters
    ----------
    item : mapping
        ``side_px``, ``thresholds`` and ``seed``; ``options`` and ``n_frames`` unless those of
        the suite.

    Returns
    -------
    dict
        ``alarms``: for each threshold, whether there was a trajectory.
    """
    frames = noise(np.random.default_rng(item['seed']), item['side_px'],
                   item.get('n_frames', N_FRAMES))
    options = item.get('options', {})
    alarms = [False] * len(item['thresholds'])
    # The search starts with the best path of all, so what a low threshold does not find, a higher
    # one does not find either.
    for number in np.argsort(item['thresholds']):
        if not search({**options, 'threshold': item['thresholds'][number]}, frames).found:
            break
        alarms[number] = True
    return {'alarms': alarms}
