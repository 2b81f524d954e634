"""Who carries out work: this process, the cores of this machine, or a cluster."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from functools import partial
import logging
from typing import Any

from track_before_detect.errors import DataError, MissingExtraError, ParameterError
from track_before_detect.parallel import at_most_cores, usable_cores

LOCAL = 'loky'
# Backends that reach other machines, and the extra that installs each.
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
        """Yield what a function returns for each argument, in any order.

        Close the iterator when it is left early, which ends the workers that it started.
        """
        if self.backend == 'dask':
            yield from self._on_dask(call, arguments)
            return
        alone = self.backend == LOCAL and self.jobs == 1
        joblib = None if alone else _joblib(required=self != Workers())
        if joblib is None:
            yield from map(call, arguments)
            return
        jobs = self.jobs or usable_cores()
        # Threads of runs that go on side by side would only wait for each other.
        cores = 1 if self.backend in CLUSTERS else max(1, usable_cores() // jobs)
        with _backend(joblib, self.backend, self.scheduler, jobs) as n_jobs:
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

    def _on_dask(self, call: Callable[[Any], Any], arguments: Sequence[Any]) -> Iterator[Any]:
        """Yield the results of a Dask cluster; what a worker took with it is done by another."""
        with _naming_what_is_missing('dask', self.scheduler), ExitStack() as stack:
            from distributed import as_completed, Client, KilledWorker, LocalCluster
            # Whoever sees our log wants to know nothing of who talks to whom.
            logging.getLogger('distributed').setLevel(logging.ERROR)
            cluster = self.scheduler
            if cluster is None:
                cluster = stack.enter_context(LocalCluster(
                    n_workers=self.jobs or usable_cores(), threads_per_worker=1,
                    dashboard_address='127.0.0.1:0'))
            client = stack.enter_context(Client(cluster))
            owners = stack.pop_all()
        with owners:
            # Equal calls are made each: what is kept of them is not Dask's matter.
            futures = dict(zip(
                client.map(partial(_on_cores, 1, call), arguments, pure=False), arguments,
                strict=True))
            fatal = []
            for future in as_completed(futures):
                try:
                    yield future.result()
                except KilledWorker:
                    fatal.append(futures[future])
                # The cluster need not keep what has come.
                future.release()
        if fatal:
            # After all others, which can be kept.
            raise DataError(f'every worker that tried it died, as where memory runs out: {fatal}')


def _on_cores(cores: int, call: Callable[[Any], Any], argument: Any) -> Any:
    with at_most_cores(cores):
        return call(argument)


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
def _naming_what_is_missing(backend: str, scheduler: str | None) -> Iterator[None]:
    """Say of a cluster that cannot be had what to install, or where none answers."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f'the backend {backend} is not installed: pip install '
            f"'track_before_detect[{CLUSTERS[backend]}]'") from error
    except (OSError, TimeoutError, ValueError) as error:
        raise ParameterError(
            f'no {backend} cluster answers at {scheduler}: {error}') from error


@contextmanager
def _backend(joblib: Any, backend: str, scheduler: str | None, jobs: int) -> Iterator[int]:
    """Make a backend the one that joblib uses; yields the number of jobs to ask for."""
    with ExitStack() as stack:
        with _naming_what_is_missing(backend, scheduler):
            if backend == 'ray':
                import ray
                from ray.util.joblib import register_ray
                ray.init(address=scheduler, num_cpus=None if scheduler else jobs)
                stack.callback(ray.shutdown)
                register_ray()
            stack.enter_context(joblib.parallel_config(backend))
        yield -1 if backend in CLUSTERS else jobs
