"""Time of dynamic programming over whole pixels for each frame, beside NumPy and the paper's.

The merit functions alone are measured. The paper's Table 1 (Fu et al. 2022) has the times of
single targets, which a maximum over the pixels adds little to, in MATLAB on an Intel i5-2400.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import functools
from typing import Any

import numpy as np

from track_before_detect.evaluation.benchmarks.bench import Bench, SEED
from track_before_detect.evaluation.benchmarks.numpy_merit import numpy_merit_functions
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.models.motion.velocity_candidates import straight_lines, whole_velocities
from track_before_detect.solvers.ring.merit_functions import merit_functions

# As many as the longest sequences of the paper.
N_FRAMES = 100
# NumPy is slow enough to be measured on fewer.
N_FRAMES_NUMPY = 12
THREADS = (1, 2)
SPEEDS = (1, 2)
ORDERS = ('cfo', 'cso', 'mff')
# Milliseconds a frame of 128 x 128 pixels in Table 1 of the paper, in one direction and as a ring.
PAPER_MS = {
    ('cfo', 1): (15, 29), ('cso', 1): (57, 117), ('mff', 1): (75, 155),
    ('cfo', 2): (32, 63), ('cso', 2): (165, 343), ('mff', 2): (227, 449),
}
PAPER_SIDE_PX = 128
LARGE_SIDE_PX = 512

_ms = functools.partial(in_ms, digits=3)


@dataclass(frozen=True)
class Order:
    """One order and largest velocity in square frames; NumPy is slow enough to get fewer."""

    side_px: int
    order: str
    v_max: int
    n_frames: int = N_FRAMES
    n_frames_numpy: int = N_FRAMES_NUMPY

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure it; NumPy and the compiled methods take turns."""
        frames = np.random.default_rng(SEED).standard_normal(
            (self.n_frames, self.side_px, self.side_px), dtype=np.float32)
        few = frames[:self.n_frames_numpy]
        variants = [(f'{self.order}_dp{ring}', n_threads)
                    for ring in ('', 'r') for n_threads in THREADS]

        def accumulate(method: str, n_threads: int) -> Callable[[], Any]:
            return lambda: merit_functions(frames, method, self.v_max, n_threads)

        stages = [accumulate(*variant) for variant in variants]
        # Compilation is not what a frame costs.
        for stage in stages:
            stage()
        *compiled, plain = timed(
            [*stages, lambda: numpy_merit_functions(few, self.order, self.v_max)], repeats)
        compiled = [seconds / len(frames) for seconds in compiled]
        plain /= len(few)
        ratio = plain[:, 1] / compiled[0][:, 1]
        return {
            'side_px': self.side_px, 'order': self.order, 'v_max': self.v_max,
            'n_candidates': len(whole_velocities(self.v_max) if self.order == 'cfo'
                                else straight_lines(self.v_max)),
            'methods': [{'method': method, 'threads': n_threads, 'per_frame': summary(seconds)}
                        for (method, n_threads), seconds in zip(variants, compiled, strict=True)],
            'numpy': summary(plain),
            'numpy_over_compiled_cpu': {
                'of_minima': float(plain[:, 1].min() / compiled[0][:, 1].min()),
                'median': float(np.median(ratio))},
            'paper_ms': (list(PAPER_MS[self.order, self.v_max])
                         if self.side_px == PAPER_SIDE_PX else None),
        }


def cases(large: bool) -> dict[str, list[Order]]:
    """Return every method for largest velocities of 1 and 2 pixels per frame."""
    sides = [PAPER_SIDE_PX, LARGE_SIDE_PX] if large else [PAPER_SIDE_PX]
    return {'cases': [Order(side, order, v_max)
                      for side in sides for v_max in SPEEDS for order in ORDERS]}


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows = [('frames', 'v_max', 'candidates', 'method', '1 thread', 'its CPU', '2 threads',
             'ring/plain', 'NumPy', 'NumPy/1 thread', 'paper')]
    for case in measured['cases']:
        times = {(one['method'], one['threads']): one['per_frame'] for one in case['methods']}
        names = list(dict.fromkeys(method for method, _ in times))
        plain_cpu = times[names[0], 1]['cpu_s']['min']
        for ring, name in enumerate(names):
            ratio = case['numpy_over_compiled_cpu']
            rows.append((
                f'{case["side_px"]} x {case["side_px"]}', str(case['v_max']),
                str(case['n_candidates']), name, _ms(times[name, 1]['wall_s']),
                _ms(times[name, 1]['cpu_s']), _ms(times[name, 2]['wall_s']),
                f'{times[name, 1]["cpu_s"]["min"] / plain_cpu:.2f}' if ring else '',
                '' if ring else _ms(case['numpy']['cpu_s']),
                '' if ring else f'{ratio["of_minima"]:.1f} ({ratio["median"]:.1f})',
                str(case['paper_ms'][ring]) if case['paper_ms'] else ''))
    return [
        *aligned(rows),
        f'Times in ms a frame, least of {measured["repeats"]} (median in brackets); ratios and '
        'NumPy by CPU time.',
        'Paper: Table 1 of Fu et al. 2022 (MATLAB, Intel i5-2400 at 3.1 GHz).']


BENCH = Bench('dp', cases, _lines)
