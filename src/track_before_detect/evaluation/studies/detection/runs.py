"""Single runs of the suite ``detection``."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import functools
import json
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import Scenario, simulate, SimulatedRecording
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch

# A target is found when the mean position error over the batch is below this.
FOUND_PX = 1.5
TARGETS, NOISE = 'three_targets', 'noise'


@dataclasses.dataclass(frozen=True)
class Run:
    """One simulated batch and what was found in it.

    ``distances`` holds the position errors of found targets, shape (K, T), and ``statistics``
    those of the trajectories that found them.
    """

    scenario: str
    seed: int
    n_targets: int
    n_found: int
    n_false: int
    rmse_px: float
    largest_statistic: float
    threshold: float
    status: str
    cpu_s: float
    wall_s: float
    distances: NDArray
    statistics: NDArray

    def row(self) -> dict[str, Any]:
        """Return what goes into the table."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)
                if field.name not in ('distances', 'statistics')}

    def written(self) -> dict[str, Any]:
        """Return the run as JSON holds it."""
        return {**vars(self), 'distances': self.distances.tolist(),
                'statistics': self.statistics.tolist()}

    @classmethod
    def read(cls, written: Mapping[str, Any]) -> Run:
        """Return the run that was written."""
        distances = written['distances'] or np.zeros((0, 0))
        return cls(**{**written, 'distances': np.array(distances, float),
                      'statistics': np.array(written['statistics'], float)})


def measure(item: Mapping[str, Any]) -> dict[str, Any]:
    """Search one simulated batch.

    Parameters
    ----------
    item : mapping
        ``scenario``, ``seed``, ``overrides`` of the scenario and ``threshold``.
    """
    overrides = item['overrides']
    pipeline = _warm_pipeline(item['scenario'], json.dumps(overrides), item['threshold'])
    made = simulate(item['scenario'], item['seed'], **overrides)
    pipeline.reset()
    wall, cpu = time.perf_counter(), time.process_time()
    result = pipeline.process(_batch(made))
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    targets = made.truth[:, 2:].reshape(-1, len(made.frames), 2)
    matching = match_trajectories(
        [trajectory.positions for trajectory in result.trajectories], targets, FOUND_PX)
    statistics = np.array([trajectory.statistic for trajectory in result.trajectories])
    # The first search finds the best of all paths, be it above the threshold or not.
    largest = (1 + result.history[0].violation) * result.threshold
    return Run(
        item['scenario'], item['seed'], len(targets), len(matching.pairs),
        len(result.trajectories) - len(matching.pairs), rmse_of(matching.distances),
        float(max([largest, *statistics])), result.threshold, result.status, cpu, wall,
        matching.distances, statistics[matching.pairs[:, 0]]).written()


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
    pipeline.process(_batch(made))
    return pipeline


def _batch(made: SimulatedRecording) -> FrameBatch:
    return FrameBatch(made.frames, made.stamps, np.arange(len(made.frames)))
