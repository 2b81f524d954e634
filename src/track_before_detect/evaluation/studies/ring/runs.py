"""Single runs of the suites ``ring-single`` and ``ring-multi`` (Fu et al. 2022, Section 4)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_before_detect.evaluation.metrics.paper_metrics import count_points
from track_before_detect.evaluation.studies.ring import scenes
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.solvers.ring.several_targets import several_targets, single_target

Item = Mapping[str, Any]


def single(item: Item) -> dict[str, int]:
    """Return in how many frames each method has its maximum within a pixel of the target.

    Parameters
    ----------
    item : mapping
        ``case``, ``n_frames``, ``snr`` and ``seed``.
    """
    # The target is in the middle of the pixel it raises.
    truth = np.rint(scenes.ring_single(item['case'], item['n_frames']))
    frames = scenes.point_frames(np.random.default_rng(item['seed']), truth[None], item['snr'])
    v_max = scenes.SINGLE_V_MAX[item['case']]
    return {method: count_points([single_target(frames, method, v_max)], [truth])[0]
            for method in METHODS}


def multi(item: Item) -> dict[str, list[int]]:
    """Return detected and false points of each method, which is told the number of targets.

    Parameters
    ----------
    item : mapping
        ``case``, ``snr``, ``n_frames`` and ``seed``.
    """
    truth = np.rint(scenes.ring_multi(item['case'], item['n_frames']))
    frames = scenes.point_frames(np.random.default_rng(item['seed']), truth, item['snr'])
    counts = {}
    for method in METHODS:
        found = several_targets(frames, method, scenes.MULTI_V_MAX, len(truth))
        counts[method] = list(count_points([one.positions for one in found], truth))
    return counts
