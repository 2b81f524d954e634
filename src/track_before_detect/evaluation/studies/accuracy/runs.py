"""Single runs of the suite ``accuracy``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.detectors import search
from track_before_detect.evaluation.studies import single_target

# A second trajectory this near to a target is made by it, not by noise.
GHOST_PX = 6 * single_target.SIGMA_PX


def isolated_target(item: Mapping[str, Any]) -> dict[str, Any]:
    """Search one batch with a bright target of constant velocity.

    Parameters
    ----------
    item : mapping
        ``side_px`` of the frames, ``snr`` and ``sigma_px`` of the target, ``threshold`` and
        ``seed``.

    Returns
    -------
    dict
        Number of trajectories, and of those beside the strongest one that are less than
        :data:`GHOST_PX` from the target on average; of the strongest one, squared position error
        in each frame (mean over both axes) and mean amplitude over the true one, None where
        nothing was found.
    """
    rng = np.random.default_rng(item['seed'])
    middle = 0.5 * (item['side_px'] - 1)
    truth = single_target.random_path(rng, 'line') + middle + rng.uniform(-3, 3, 2)
    frames = single_target.frames_with(rng, item['side_px'], truth, item['snr'], item['sigma_px'])
    found = search({'threshold': item['threshold']}, frames).found
    if not found:
        return {'n_found': 0, 'n_ghosts': 0, 'squared_errors': None, 'amplitude': None}
    best = max(found, key=lambda one: one.statistic)
    others = single_target.mean_errors([one for one in found if one is not best], truth)
    return {'n_found': len(found), 'n_ghosts': sum(error < GHOST_PX for error in others),
            'squared_errors': ((best.positions - truth)**2).mean(axis=1).tolist(),
            'amplitude': float(best.amplitudes.mean() / item['snr'])}
