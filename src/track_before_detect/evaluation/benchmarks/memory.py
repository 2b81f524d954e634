"""Time and memory of searches that hold all their states, or as few as ``max_memory_gb`` allows.

Every detection runs in a process of its own, so that its peak memory is its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from track_before_detect.evaluation.benchmarks.bench import Bench, CaseApart, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.options import DetectorOptions
from track_before_detect.runs.own_process import peak_memory
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.memory import BYTES_PER_GB
from track_before_detect.solvers.search.viterbi_table import table_bytes, ViterbiTable
from track_before_detect.types import FrameBatch

ALL_GB = 1000.0
# Given, for the calibration of a threshold is not what is measured.
THRESHOLD = 8.0


@dataclass(frozen=True)
class Case(CaseApart):
    """Six targets in frames of a size, which may be fast, and the memory of their search."""

    shape: tuple[int, int]
    max_speed_px_s: float
    max_memory_gb: float

    def measure_here(self, repeats: int) -> dict[str, Any]:
        """Measure it in this process."""
        height, width = self.shape
        made = simulate('three_targets', SEED, height=height, width=width, n_frames=20,
                        n_targets=6, snr=5.0)
        options = DetectorOptions(
            psf_sigma_px=made.scenario.psf_sigma_px, threshold=THRESHOLD,
            max_speed_px_s=self.max_speed_px_s * made.scenario.fps,
            max_memory_gb=self.max_memory_gb)
        detector = ConvexDetector(options)
        before = peak_memory()
        batch = FrameBatch.of(made.frames, made.stamps)
        result = detector.detect(batch)
        [detection] = timed([lambda: detector.detect(batch)], repeats)
        peak = peak_memory()
        graph = detector.graph(made.stamps, self.shape)
        shape = detector.task(batch, THRESHOLD).search.grid_shape
        table = ViterbiTable(graph, shape, most_bytes=(
            math.inf if self.max_memory_gb == ALL_GB else 0.0))
        scores = np.random.default_rng(SEED).exponential(size=(graph.n_frames, *shape))
        scores = scores.astype(np.float32)
        table.fill(scores)
        [filling] = timed([lambda: table.fill(scores)], repeats)
        return {
            'height_px': height, 'width_px': width, 'max_speed_px_per_frame': self.max_speed_px_s,
            'max_memory_gb': self.max_memory_gb, 'n_segments': graph.n_segments,
            'n_velocities': graph.n_velocities, 'all_states_bytes': table_bytes(graph, shape),
            'n_trajectories': len(result.found), 'peak_memory_bytes': peak,
            'peak_memory_before_bytes': before, 'detection': summary(detection),
            'fill': summary(filling)}


CASES = tuple(Case(shape, speed, memory)
              for shape, speed, little in (((206, 320), 4.0, 0.7), ((1024, 1024), 1.0, 1.0))
              for memory in (ALL_GB, little))


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ('frames', 'up to', 'max_memory_gb', 'found', 'peak GB', 'before', 'detection', 'its CPU',
         'table filled', 'its CPU')]
    for case in measured['cases']:
        rows.append((
            f'20 x {case["width_px"]} x {case["height_px"]}',
            f'{case["max_speed_px_per_frame"]:g} px/frame',
            'all states' if case['max_memory_gb'] == ALL_GB else f'{case["max_memory_gb"]:g}',
            str(case['n_trajectories']),
            *(f'{case[key] / BYTES_PER_GB:.2f}'
              for key in ('peak_memory_bytes', 'peak_memory_before_bytes')),
            *(in_ms(case[stage][clock], 0) for stage in ('detection', 'fill')
              for clock in ('wall_s', 'cpu_s'))))
    return [*aligned(rows), '',
            f'Times in ms, least of {measured["repeats"]} (median in brackets); a table is filled '
            'on one thread, with as few states held as can be where memory is short.']


BENCH = Bench('memory', lambda large: {'cases': CASES}, _lines)
