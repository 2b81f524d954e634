"""Time and memory of large frames that are searched in tiles, with a target across every seam."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.bench import Bench, CaseApart, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.options import DetectorOptions
from track_before_detect.runs.own_process import peak_memory
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.search.memory import BYTES_PER_GB
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import DetectionResult, FrameBatch

N_FRAMES, SNR, SPEED_PX = 20, 5.0, 0.8
# Given, for the calibration of a threshold is not what is measured.
THRESHOLD = 8.5


@dataclass(frozen=True)
class Case(CaseApart):
    """Square frames of noise and targets, and the side of a tile."""

    side_px: int
    tile_px: int

    def measure_here(self, repeats: int) -> dict[str, Any]:
        """Measure it in this process."""
        frames, truth = scene(self)
        batch = FrameBatch.of(frames, np.arange(float(N_FRAMES)))

        def search() -> DetectionResult:
            options = DetectorOptions(tile_px=self.tile_px, threshold=THRESHOLD)
            return TrackingPipeline(options).process(batch)

        found = np.array([one.positions for one in search().trajectories])
        peak = peak_memory()
        [seconds] = timed([search], repeats)
        near = [int(np.sum(np.hypot(*np.nanmean(found - track, axis=1).T) < 1)) for track in truth]
        return {'side_px': self.side_px, 'tile_px': self.tile_px, 'n_targets': len(truth),
                'n_found_once': near.count(1), 'n_trajectories': len(found),
                'peak_memory_bytes': peak, 'detection': summary(seconds)}


def cases(large: bool) -> dict[str, tuple[Case, ...]]:
    """Return what ``tbd bench tiles`` measures."""
    large_px = (1024, 2048, 4096) if large else ()
    return {'cases': (Case(512, 256), *(Case(side, 512) for side in large_px))}


def scene(case: Case) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return frames of noise with targets, and where these are, as :func:`planted` has it."""
    rng = np.random.default_rng(SEED)
    frames = rng.standard_normal((N_FRAMES, case.side_px, case.side_px), dtype=np.float32)
    truth = planted(case)
    for track in truth:
        for frame, (x, y) in zip(frames, track, strict=True):
            add_target(frame, x, y, 1.0, SNR)
    return frames, truth


def planted(case: Case) -> NDArray[np.float64]:
    """Return the positions (N, T, 2) of a target on each side of a tile and on each corner."""
    rng = np.random.default_rng(SEED)
    seams = np.arange(case.tile_px, case.side_px, case.tile_px) - 0.5
    middles = np.arange(case.tile_px / 2, case.side_px, case.tile_px)
    places = [(seam, other) for seam in seams for other in (*middles, *seams)]
    places += [(other, seam) for seam in seams for other in middles]
    angles = rng.uniform(0, 2 * np.pi, len(places))
    velocities = SPEED_PX * np.column_stack([np.cos(angles), np.sin(angles)])
    times = np.arange(N_FRAMES) - (N_FRAMES - 1) / 2
    return np.array(places)[:, None] + times[:, None] * velocities[:, None]


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ('frames', 'tiles', 'targets', 'found once', 'found', 'peak GB', 'detection', 'its CPU')]
    for case in measured['cases']:
        rows.append((
            f'{N_FRAMES} x {case["side_px"]} x {case["side_px"]}', str(case['tile_px']),
            *(str(case[key]) for key in ('n_targets', 'n_found_once', 'n_trajectories')),
            f'{case["peak_memory_bytes"] / BYTES_PER_GB:.2f}',
            *(in_ms(case['detection'][clock], 0) for clock in ('wall_s', 'cpu_s'))))
    return [*aligned(rows), '',
            f'Times in ms, least of {measured["repeats"]} (median in brackets). Targets of SNR '
            f'{SNR:g} lie across each seam of the tiles.']


BENCH = Bench('tiles', cases, _lines)
