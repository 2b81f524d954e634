"""Single runs of the suite ``dim``."""

from collections.abc import Mapping
import functools
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.detectors import search
from track_before_detect.evaluation.studies import single_target
from track_before_detect.evaluation.studies.dim.line_filter import LineFilter

SIDE_PX = 128
# A target is found by a trajectory whose mean error is below this; targets are placed this far
# inside.
FOUND_PX = 2.0
MARGIN_PX = 15.0
MODELS = ('constant', 'fluctuating')


def dim_target(item: Mapping[str, Any]) -> dict[str, Any]:
    """Search one batch with a dim target by both amplitude models and exhaustively.

    Parameters
    ----------
    item : mapping
        ``motion`` (``line`` or ``arc``), ``snr``, ``seed`` and ``thresholds`` by model.

    Returns
    -------
    dict
        By model: whether the detector ``found`` the target, and ``nearby``, the largest statistic
        of a straight path within :data:`FOUND_PX` of it (None if there is none).
    """
    rng = np.random.default_rng(item['seed'])
    truth = single_target.random_path(rng, item['motion']) + rng.uniform(
        MARGIN_PX, SIDE_PX - 1 - MARGIN_PX, 2)
    frames = single_target.frames_with(rng, SIDE_PX, truth, item['snr'])
    found, nearby = {}, {}
    for model in MODELS:
        result = search({'amplitude_model': model, 'threshold': item['thresholds'][model]}, frames)
        errors = single_target.mean_errors(result.found, truth)
        found[model] = min(errors, default=np.inf) < FOUND_PX
        nearby[model] = line_filter(model).best_near(frames, truth, FOUND_PX)
    return {'found': found, 'nearby': nearby}


def dim_noise(item: Mapping[str, Any]) -> dict[str, float]:
    """Search one batch of noise exhaustively: the largest statistic by model; needs ``seed``."""
    frames = single_target.noise(np.random.default_rng(item['seed']), SIDE_PX)
    return {model: line_filter(model).best(frames) for model in MODELS}


@functools.lru_cache(maxsize=2)
def line_filter(model: str) -> LineFilter:
    """Return the exhaustive search with the statistic of an amplitude model."""
    return LineFilter(single_target.N_FRAMES, single_target.SPEEDS_PX[1],
                      single_target.SIGMA_PX, model)
