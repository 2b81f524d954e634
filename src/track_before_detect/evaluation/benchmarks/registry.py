"""What ``tbd bench`` can measure, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from track_before_detect.errors import ParameterError, suggestion
from track_before_detect.evaluation.benchmarks.convex import bench_table, measure_convex
from track_before_detect.evaluation.benchmarks.dp import dp_table, measure_dp
from track_before_detect.evaluation.benchmarks.fit import fit_table, measure_fit
from track_before_detect.evaluation.benchmarks.parallel import measure_parallel, parallel_table
from track_before_detect.evaluation.benchmarks.velocity_filter import (
    measure_velocity,
    velocity_table,
)
from track_before_detect.types import Progress


@dataclass(frozen=True)
class Bench:
    """One bench.

    Attributes
    ----------
    measure : callable
        Told the number of measurements of each stage, whether to measure large frames too, and
        whom to tell of the progress; returns the measurements as plain numbers.
    table : callable
        Returns the measurements as text.
    """

    measure: Callable[[int, bool, Progress], dict[str, Any]]
    table: Callable[[Mapping[str, Any]], str]


BENCHES: dict[str, Bench] = {
    'convex': Bench(measure_convex, bench_table),
    'dp': Bench(measure_dp, dp_table),
    'fit': Bench(measure_fit, fit_table),
    'parallel': Bench(measure_parallel, parallel_table),
    'velocity_filter': Bench(measure_velocity, velocity_table),
}


def bench_named(name: str) -> Bench:
    """Return a bench, or say which there are."""
    if name not in BENCHES:
        raise ParameterError(f'unknown bench {name!r}; {suggestion(name, BENCHES)}')
    return BENCHES[name]
