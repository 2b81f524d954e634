"""Time of shift-and-stack over constant velocities, beside NumPy in the same run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.bench import Bench, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.velocity_grid import velocity_grid, VelocityGrid
from track_before_detect.solvers.pixel_statistics import measure
from track_before_detect.solvers.velocity.shift_and_stack import VelocityStack

N_FRAMES = 20
SIDES_PX = (128, 512)
# Velocity components up to one pixel per frame, one pixel per batch apart: 39 x 39 velocities.
MAX_SPEED_PX = 1.0
LEAST_PHI = 2.0
THREADS = (1, 2)

_ms = functools.partial(in_ms, digits=1)


@dataclass(frozen=True)
class Square:
    """A search of square frames, with a variance for each pixel and masks."""

    side_px: int
    n_frames: int = N_FRAMES

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure it."""
        rng = np.random.default_rng(SEED)
        frames = rng.standard_normal((self.n_frames, self.side_px, self.side_px), np.float32)
        frames[rng.random(frames.shape) < 0.05] = np.nan
        weights = rng.uniform(0.5, 1.5, (1, *frames.shape[1:])).astype(np.float32)
        psf = GaussianPsf(1.0)
        grid = velocity_grid(np.arange(float(self.n_frames)), MAX_SPEED_PX, disc=False)
        data = measure(frames, psf, weights)
        psi, phi = data.psi[0], data.phi
        stacks = [VelocityStack(grid, psi.shape[1:], LEAST_PHI, n_threads=n) for n in THREADS]

        def search(stack: VelocityStack) -> Callable[[], Any]:
            return lambda: stack.run(psi, phi)

        plain = numpy_stack(psi, phi, grid, LEAST_PHI)
        for stack in stacks:
            stack.run(psi, phi)
        seconds = timed([lambda: measure(frames, psf, weights), *map(search, stacks)], repeats)
        # NumPy takes as long as all of the others together.
        [slow] = timed([lambda: numpy_stack(psi, phi, grid, LEAST_PHI)], min(repeats, 3))
        return {
            'n_frames': self.n_frames, 'side_px': self.side_px, 'n_velocities': grid.n_velocities,
            'additions': grid.plan.n_additions,
            'plain_additions': len(grid.axis) * (self.n_frames - 1),
            'largest_difference': float(np.abs(plain - stacks[0].best).max()),
            'psi_and_phi': summary(seconds[0]),
            'search': {str(n): summary(one) for n, one in zip(THREADS, seconds[1:], strict=True)},
            'numpy': summary(slow),
        }


def numpy_stack(psi: NDArray, phi: NDArray, grid: VelocityGrid,
                least_phi: float) -> NDArray[np.float32]:
    """Return the largest psi / sqrt(phi) of each position, by slices of whole frames."""
    n_frames, height, width = psi.shape
    reach = int(np.abs(grid.moves).max())
    around = np.pad(np.stack([psi, phi]), ((0, 0), (0, 0), (reach, reach), (reach, reach)))
    best = np.zeros((height, width), np.float32)
    sums = np.empty((2, height, width), np.float32)
    for i, (first, last) in enumerate(zip(grid.first_vx, grid.last_vx, strict=True)):
        for j in range(first, last):
            sums[:] = 0
            for t in range(n_frames):
                y, x = reach + grid.moves[i, t], reach + grid.moves[j, t]
                sums += around[:, t, y:y + height, x:x + width]
            statistic = sums[0] / np.sqrt(np.maximum(sums[1], np.float32(least_phi)))
            np.maximum(best, statistic, out=best, where=sums[1] > least_phi)
    return best


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows = [('frames', 'velocities', 'psi and phi', '1 thread', 'its CPU', '2 threads', 'NumPy',
             'NumPy/1 thread')]
    for case in measured['cases']:
        alone = case['search']['1']
        rows.append((
            f'{case["n_frames"]} x {case["side_px"]} x {case["side_px"]}',
            str(case['n_velocities']), _ms(case['psi_and_phi']['wall_s']), _ms(alone['wall_s']),
            _ms(alone['cpu_s']), _ms(case['search']['2']['wall_s']), _ms(case['numpy']['cpu_s']),
            f'{case["numpy"]["cpu_s"]["min"] / alone["cpu_s"]["min"]:.1f}'))
    case = measured['cases'][0]
    return [
        *aligned(rows),
        f'Times in ms, least of {measured["repeats"]} (median in brackets); a variance for each '
        'pixel, 5 % of the pixels masked; NumPy and ratio by CPU time.',
        f'Sums shared between velocities: {case["additions"]} rows added for {case["n_frames"]} '
        f'frames and all v_x, not {case["plain_additions"]}; largest difference to NumPy '
        f'{case["largest_difference"]:.1g}.']


BENCH = Bench('velocity_filter', lambda large: {
    'cases': [Square(side) for side in (SIDES_PX if large else SIDES_PX[:1])]}, _lines)
