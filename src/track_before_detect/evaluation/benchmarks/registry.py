"""What ``tbd bench`` can measure, by name."""

from track_before_detect.errors import named
from track_before_detect.evaluation.benchmarks import (
    compilation,
    convex,
    dp,
    fit,
    memory,
    parallel,
    scene,
    tiles,
    velocity_filter,
)
from track_before_detect.evaluation.benchmarks.bench import Bench
from track_before_detect.evaluation.benchmarks.workers import bench as workers

BENCHES: dict[str, Bench] = {
    one.BENCH.name: one.BENCH for one in (
        convex, dp, fit, memory, parallel, scene, tiles, velocity_filter, compilation,
        workers)}


def bench_named(name: str) -> Bench:
    """Return a bench, or say which there are."""
    return named('bench', name, BENCHES)
