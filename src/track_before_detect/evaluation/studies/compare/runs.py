"""Single runs of the suite ``compare``: every detector on the same frames.

White noise of standard deviation 1 and unit-norm Gaussian stamps of 1 px, so SNR is the amplitude.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine import detectors
from track_before_detect.evaluation.metrics.gospa import trajectory_gospa
from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.evaluation.metrics.track_quality import track_quality
from track_before_detect.evaluation.studies.compare.scenes import shape_of, targets_of
from track_before_detect.simulation.sensor import add_path
from track_before_detect.solvers.batch_detector import FoundTrajectory

SIGMA_PX = 1.0
FOUND_PX = 2.0
# Of GOSPA: distance from which two are no pair, and price of a change of identity.
CUTOFF_PX, SWITCH_PX = 5.0, 5.0

Item = Mapping[str, Any]


def search(item: Item) -> dict[str, dict[str, float]]:
    """Search one batch by all methods.

    Parameters
    ----------
    item : mapping
        ``scene`` (of :data:`SCENES`, or ``noise`` and ``noise six``), ``snr``, ``seed``, and
        ``methods``: by name, the options of a detector with its threshold.

    Returns
    -------
    dict
        By method: targets ``found`` by a trajectory less than :data:`FOUND_PX` from them on
        average, ``false`` trajectories, the ``gospa`` distance in pixels, and the sums of the
        ``purity`` of trajectories and of the ``completeness`` of targets.
    """
    results = {}
    for name, truth, trajectories in _searched(item):
        found = [one.positions for one in trajectories]
        matched = len(match_trajectories(found, truth, FOUND_PX).pairs)
        gospa = trajectory_gospa(found, truth, cutoff_px=CUTOFF_PX, switch_px=SWITCH_PX)
        quality = track_quality(found, truth, FOUND_PX)
        results[name] = {'found': matched, 'false': len(found) - matched,
                         'gospa': gospa.distance, 'purity': float(np.sum(quality.purity)),
                         'completeness': float(np.sum(quality.completeness))}
    return results


def statistics(item: Item) -> dict[str, dict[str, list[float]]]:
    """Search one batch by all methods; arguments as of :func:`search`.

    Returns
    -------
    dict
        By method: the statistics of trajectories that are ``right``, each of another target, and
        of all others, ``false``.
    """
    results = {}
    for name, truth, trajectories in _searched(item):
        pairs = match_trajectories([one.positions for one in trajectories], truth, FOUND_PX).pairs
        right = set(pairs[:, 0].tolist())
        results[name] = {
            label: [float(one.statistic) for number, one in enumerate(trajectories)
                    if (number in right) is wanted]
            for label, wanted in (('right', True), ('false', False))}
    return results


def _searched(item: Item) -> Iterator[tuple[str, NDArray, Sequence[FoundTrajectory]]]:
    """Yield each method, the targets of the batch (N, T, 2), and the trajectories it finds."""
    rng = np.random.default_rng(item['seed'])
    truth = targets_of(item['scene'], rng)
    frames = rng.standard_normal(shape_of(item['scene']), np.float32)
    for path in truth:
        add_path(frames, path, SIGMA_PX, item['snr'])
    for name, options in item['methods'].items():
        yield name, truth, detectors.search(options, frames).found
