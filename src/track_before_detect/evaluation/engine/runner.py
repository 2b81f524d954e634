"""Carries out the runs of a study: on all cores or a cluster, and only those not done before.

A run is a function of this package and one item, a mapping that JSON can hold and that decides
everything: parameters of the scene, method, seed. So the result is the same wherever and in
whatever order runs are carried out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
import json
from typing import Any

from track_before_detect.errors import MissingExtraError, ParameterError
from track_before_detect.evaluation.engine.detectors import detector_of, Options, stamps_of
from track_before_detect.evaluation.engine.kept_results import KeptResults
from track_before_detect.parallel import at_most_cores, usable_cores
from track_before_detect.types import Progress

Item = Mapping[str, Any]
Measure = Callable[[Item], Mapping[str, Any]]

LOCAL = 'loky'
# Backends of joblib that reach other machines, and the extra that installs each.
CLUSTERS = {'dask': 'dask', 'ray': 'ray'}
BACKENDS = (LOCAL, 'threading', 'multiprocessing', *CLUSTERS)


@dataclass(frozen=True)
class Workers:
    """Who carries out the runs.

    Attributes
    ----------
    jobs : int, optional
        Runs at a time; automatic is one per core with joblib, and 1 without. A cluster that is
        already there decides for itself.
    backend : str
        One of :data:`BACKENDS`.
    scheduler : str, optional
        Address of a Dask scheduler or a Ray cluster; without one a cluster of ``jobs`` workers is
        started on this machine.
    """

    jobs: int | None = None
    backend: str = LOCAL
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise ParameterError(f'jobs must be at least 1, got {self.jobs}')
        if self.backend not in BACKENDS:
            raise ParameterError(
                f'backend must be one of {", ".join(BACKENDS)}, got {self.backend!r}')
        if self.scheduler is not None and self.backend not in CLUSTERS:
            raise ParameterError(
                f'scheduler needs the backend {" or ".join(CLUSTERS)}, got {self.backend!r}')

    def run(self, call: Callable[[Any], Any], arguments: Sequence[Any]) -> Iterator[Any]:
        """Yield what a function returns for each argument, in any order."""
        alone = self.backend == LOCAL and self.jobs == 1
        joblib = None if alone else _joblib(required=self != Workers())
        if joblib is None:
            yield from map(call, arguments)
            return
        jobs = self.jobs or usable_cores()
        # Threads of runs that go on side by side would only wait for each other.
        cores = 1 if self.backend in CLUSTERS else max(1, usable_cores() // jobs)
        with _cluster(joblib, self.backend, self.scheduler, jobs) as n_jobs:
            calls = [joblib.delayed(_on_cores)(cores, call, argument) for argument in arguments]
            try:
                parallel = joblib.Parallel(n_jobs, return_as='generator_unordered')
            except ValueError:
                # Not every backend tells of a result before it has them all.
                rounds = 4 * jobs
                for first in range(0, len(calls), rounds):
                    yield from joblib.Parallel(n_jobs)(calls[first:first + rounds])
                return
            yield from parallel(calls)


@dataclass(frozen=True)
class Runner:
    """Carries out the runs of a study.

    Attributes
    ----------
    progress : callable
        Called with a label and the share done, 0 to 1.
    workers : Workers
        Who carries them out.
    kept : KeptResults, optional
        Results on disk: what is there is not done again, what is done is kept there.
    """

    progress: Progress
    workers: Workers = Workers(jobs=1)
    kept: KeptResults | None = None

    def threshold(self, options: Options, shape: tuple[int, ...]) -> float:
        """Return the threshold of a detector for batches of ``shape`` (T, H, W)."""
        n_frames, height, width = shape
        return detector_of(options).threshold(
            stamps_of(n_frames), (height, width), self.progress)

    def map(self, measure: Measure, items: Sequence[Item], label: str) -> list[dict[str, Any]]:
        """Return the result of each item, in their order.

        Parameters
        ----------
        measure : callable
            A function of a module, told an item; returns what JSON can hold.
        items : sequence of mapping
            What to run; nothing else may decide the result.
        label : str
            What is done, for the progress.
        """
        known = {} if self.kept is None else self.kept.load(measure)
        keys = [as_text(item) for item in items]
        # An item that is asked for twice is run once.
        missing = {key: item for key, item in zip(keys, items, strict=True) if key not in known}
        done = len(items) - len(missing)
        self.progress(label, done / max(len(items), 1))
        with ExitStack() as stack:
            keep = None if self.kept is None else stack.enter_context(self.kept.writer(measure))
            # Closing ends the workers when an error or an interrupt ends the loop.
            results = self.workers.run(_Call(measure), list(missing.values()))
            stack.callback(results.close)  # type: ignore[attr-defined]
            for key, text in results:
                known[key] = json.loads(text)
                if keep is not None:
                    keep(key, text)
                done += 1
                self.progress(label, done / len(items))
        self.progress(label, 1.0)
        return [known[key] for key in keys]


def _on_cores(cores: int, call: Callable[[Any], Any], argument: Any) -> Any:
    with at_most_cores(cores):
        return call(argument)


def as_text(item: Item) -> str:
    """Return an item as text that is the same for equal items."""
    return json.dumps(item, sort_keys=True)


@dataclass(frozen=True)
class _Call:
    """Runs one item in whatever process; results travel as the text that is kept."""

    measure: Measure

    def __call__(self, item: Item) -> tuple[str, str]:
        return as_text(item), json.dumps(self.measure(item))


def _joblib(required: bool) -> Any:
    """Return joblib; None where it is missing and nobody asked for it."""
    try:
        import joblib
    except ImportError as error:
        if not required:
            return None
        raise MissingExtraError(
            "runs at the same time need joblib: pip install 'track_before_detect[parallel]'"
        ) from error
    return joblib


@contextmanager
def _cluster(joblib: Any, backend: str, scheduler: str | None, jobs: int) -> Iterator[int]:
    """Make a backend the one that joblib uses; yields the number of jobs to ask for."""
    with ExitStack() as stack:
        try:
            if backend == 'dask':
                from distributed import Client
                client = stack.enter_context(
                    Client(scheduler) if scheduler is not None else
                    Client(n_workers=jobs, threads_per_worker=1, dashboard_address=None))
                # Given the client: another one may be the default of this process.
                stack.enter_context(joblib.parallel_config('dask', client=client))
            elif backend == 'ray':
                import ray
                from ray.util.joblib import register_ray
                ray.init(address=scheduler, num_cpus=None if scheduler else jobs)
                stack.callback(ray.shutdown)
                register_ray()
                stack.enter_context(joblib.parallel_config('ray'))
            else:
                stack.enter_context(joblib.parallel_config(backend))
        except ImportError as error:
            raise MissingExtraError(
                f'the backend {backend} is not installed: pip install '
                f"'track_before_detect[{CLUSTERS[backend]}]'") from error
        except (OSError, TimeoutError) as error:
            raise ParameterError(
                f'no {backend} cluster answers at {scheduler}: {error}') from error
        yield -1 if backend in CLUSTERS else jobs
