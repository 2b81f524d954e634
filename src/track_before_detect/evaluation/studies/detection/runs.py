"""Single runs of the suite ``detection``."""

from collections.abc import Mapping
import functools
import json
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import Scenario, simulate
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch

# A target is found when the mean position error over the batch is below this.
FOUND_PX = 1.5
TARGETS, NOISE = 'three_targets', 'noise'


def measure(item: Mapping[str, Any]) -> dict[str, Any]:
    """Search one simulated batch.

    Parameters
    ----------
    item : mapping
        ``scenario``, ``seed``, ``overrides`` of the scenario and ``threshold``.

    Returns
    -------
    dict
        Numbers of targets and of what was found, the largest statistic of all paths, times; the
        ``distances`` of found targets in each frame, and the ``statistics`` of their trajectories.
    """
    overrides = item['overrides']
    pipeline = _warm_pipeline(item['scenario'], json.dumps(overrides), item['threshold'])
    made = simulate(item['scenario'], item['seed'], **overrides)
    pipeline.reset()
    wall, cpu = time.perf_counter(), time.process_time()
    result = pipeline.process(FrameBatch.of(made.frames, made.stamps))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    targets = made.truth[:, 2:].reshape(-1, len(made.frames), 2)
    matching = match_trajectories(
        [trajectory.positions for trajectory in result.trajectories], targets, FOUND_PX)
    statistics = np.array([trajectory.statistic for trajectory in result.trajectories])
    # The first search finds the best of all paths, be it above the threshold or not.
    largest = (1 + result.history[0].violation) * result.threshold
    return {
        'scenario': item['scenario'], 'seed': item['seed'], 'n_targets': len(targets),
        'n_found': len(matching.pairs), 'n_false': len(statistics) - len(matching.pairs),
        'rmse_px': rmse_of(matching.distances),
        'largest_statistic': float(max([largest, *statistics])), 'threshold': result.threshold,
        'status': result.status, 'cpu_s': cpu, 'wall_s': wall,
        'distances': matching.distances.tolist(),
        'statistics': statistics[matching.pairs[:, 0]].tolist()}


def options_for(scenario: Scenario) -> DetectorOptions:
    """Return the options of the detector for a scenario."""
    return DetectorOptions(psf_sigma_px=scenario.psf_sigma_px)


def rmse_of(distances: NDArray) -> float:
    """Return the root mean square of distances, NaN left out; NaN when there are none."""
    values = distances[np.isfinite(distances)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else float('nan')


@functools.lru_cache(maxsize=4)
def _warm_pipeline(name: str, overrides: str, threshold: float) -> TrackingPipeline:
    """Return a pipeline that has compiled and searched a batch of this size."""
    made = simulate(name, 0, **json.loads(overrides))
    pipeline = TrackingPipeline(options_for(made.scenario).replace(threshold=threshold))
    pipeline.warm_up(made.frames.shape[1:], 1 / made.scenario.fps, len(made.frames))
    # The first batch of a size also makes room for the tables of the search.
    pipeline.process(FrameBatch.of(made.frames, made.stamps))
    return pipeline
