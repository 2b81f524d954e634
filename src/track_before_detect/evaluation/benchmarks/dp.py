"""Time of dynamic programming over whole pixels for each frame, beside NumPy and the paper's.

The merit functions alone are measured. The paper's Table 1 (Fu et al. 2022) has the times of
single targets, which a maximum over the pixels adds little to, in MATLAB on an Intel i5-2400.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_before_detect.evaluation.benchmarks.numpy_merit import numpy_merit_functions
from track_before_detect.evaluation.benchmarks.timing import (
    aligned,
    checked_repeats,
    in_ms,
    summary,
    timed,
)
from track_before_detect.evaluation.engine.machine import describe_machine, machine_line
from track_before_detect.models.motion.velocity_candidates import straight_lines, whole_velocities
from track_before_detect.solvers.ring.merit_functions import merit_functions
from track_before_detect.types import Progress

SEED = 1
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


def measure_dp(repeats: int, large: bool, progress: Progress) -> dict[str, Any]:
    """Measure every method for largest velocities of 1 and 2 pixels per frame.

    Parameters
    ----------
    repeats : int
        Measurements of each method.
    large : bool
        Whether to measure frames of 512 x 512 pixels too.
    progress : callable
        Called with a label and the share done, 0 to 1.

    Returns
    -------
    dict
        ``bench``, ``seed``, ``repeats``, ``machine`` and ``cases``; times in seconds a frame.
    """
    checked_repeats(repeats)
    cases = [(side, order, v_max)
             for side in ([PAPER_SIDE_PX, LARGE_SIDE_PX] if large else [PAPER_SIDE_PX])
             for v_max in SPEEDS for order in ORDERS]
    measured = []
    for number, case in enumerate(cases):
        progress('measuring', number / len(cases))
        measured.append(measure_case(*case, repeats))
    progress('measuring', 1.0)
    return {'bench': 'dp', 'seed': SEED, 'repeats': repeats, 'machine': describe_machine(),
            'cases': measured}


def measure_case(side_px: int, order: str, v_max: int, repeats: int) -> dict[str, Any]:
    """Measure one order and largest velocity; NumPy and the compiled methods take turns."""
    frames = np.random.default_rng(SEED).standard_normal(
        (N_FRAMES, side_px, side_px), dtype=np.float32)
    few = frames[:N_FRAMES_NUMPY]
    variants = [(f'{order}_dp{ring}', n_threads) for ring in ('', 'r') for n_threads in THREADS]

    def accumulate(method, n_threads):
        return lambda: merit_functions(frames, method, v_max, n_threads)

    stages = [accumulate(*variant) for variant in variants]
    # Compilation is not what a frame costs.
    for stage in stages:
        stage()
    *compiled, plain = timed(
        [*stages, lambda: numpy_merit_functions(few, order, v_max)], repeats)
    plain /= len(few)
    methods = [{'method': method, 'threads': n_threads, 'per_frame': summary(seconds / N_FRAMES)}
               for (method, n_threads), seconds in zip(variants, compiled, strict=True)]
    one_thread = compiled[0] / N_FRAMES
    return {
        'side_px': side_px,
        'order': order,
        'v_max': v_max,
        'n_candidates': len(whole_velocities(v_max) if order == 'cfo' else straight_lines(v_max)),
        'methods': methods,
        'numpy': summary(plain),
        'numpy_over_compiled_cpu': {
            'of_minima': float(plain[:, 1].min() / one_thread[:, 1].min()),
            'median': float(np.median(plain[:, 1] / one_thread[:, 1])),
        },
        'paper_ms': list(PAPER_MS[order, v_max]) if side_px == PAPER_SIDE_PX else None,
    }


def dp_table(measured: Mapping[str, Any]) -> str:
    """Return the measurements as text."""
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
    lines = aligned(rows)
    lines += [
        f'Times in ms a frame, least of {measured["repeats"]} (median in brackets); ratios and '
        'NumPy by CPU time.',
        'Paper: Table 1 of Fu et al. 2022 (MATLAB, Intel i5-2400 at 3.1 GHz).',
        f'{machine_line()}.',
    ]
    return '\n'.join(lines)


def _ms(times):
    return in_ms(times, 3)
