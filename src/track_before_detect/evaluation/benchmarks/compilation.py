"""Time of compiling the loops of a search from nothing, in a process and a cache of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import os
import tempfile
from typing import Any

import numpy as np

from track_before_detect.evaluation.benchmarks.bench import Bench
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.options import DetectorOptions
from track_before_detect.runs.own_process import in_own_process
from track_before_detect.tracking.pipeline import TrackingPipeline


@dataclass(frozen=True)
class Case:
    """The loops of one search."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure it, each time in a new process and an empty folder."""
        before = os.environ.get('NUMBA_CACHE_DIR')
        seconds = []
        try:
            for _ in range(repeats):
                with tempfile.TemporaryDirectory() as folder:
                    # Numba reads it when the new process imports it.
                    os.environ['NUMBA_CACHE_DIR'] = folder
                    seconds.append(in_own_process(compile_loops, self))
        finally:
            if before is None:
                del os.environ['NUMBA_CACHE_DIR']
            else:
                os.environ['NUMBA_CACHE_DIR'] = before
        return {'name': self.name, 'options': dict(self.options),
                'compilation': summary(np.array(seconds))}


def compile_loops(case: Case) -> tuple[float, float]:
    """Compile in this process; return wall and CPU seconds."""
    pipeline = TrackingPipeline(DetectorOptions(**case.options))
    [[(wall_s, cpu_s)]] = timed([pipeline.compile], 1).tolist()
    return wall_s, cpu_s


def cases(large: bool) -> dict[str, Sequence[Case]]:
    """Return what ``tbd bench compilation`` measures."""
    more = [Case('constant complex', {'amplitudes': 'complex', 'amplitude_model': 'constant'}),
            *(Case(name, {'detector': name}) for name in ('mff_dpr', 'mt_dp', 'velocity_filter'))]
    return {'cases': [Case('default'), *(more if large else ())]}


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows = [('search', 'compiled in', 'its CPU')]
    rows += [(case['name'], in_ms(case['compilation']['wall_s'], 0),
              in_ms(case['compilation']['cpu_s'], 0)) for case in measured['cases']]
    return [*aligned(rows), '',
            f'Times in ms, least of {measured["repeats"]} (median in brackets).']


BENCH = Bench('compilation', cases, _lines)
