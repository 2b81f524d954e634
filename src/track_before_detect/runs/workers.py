"""Who carries out work: this process, the cores of this machine, or a cluster."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
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

    @contextmanager
    def staying(self) -> Iterator['Workers']:
        """Yield workers that stay from one run to the next, where each would start its own."""
        if self.backend != 'dask' or self.scheduler is not None:
            yield self
            return
        with ExitStack() as stack:
            with _naming_what_is_missing('dask', None):
                import dask
                from distributed import LocalCluster
                _hush()
                # What died with a worker is tried again here, see _on_dask.
                stack.enter_context(dask.config.set({'distributed.scheduler.allowed-failures': 0}))
                cluster = stack.enter_context(LocalCluster(
                    n_workers=self.count(), threads_per_worker=1,
                    dashboard_address='127.0.0.1:0', silence_logs=logging.CRITICAL))
            yield replace(self, scheduler=cluster.scheduler_address)

    def count(self) -> int:
        """Return how many runs go on at a time."""
        if self.scheduler is None or self.backend != 'dask':
            return self.jobs or usable_cores()
        with self._client() as client:
            return max(1, sum(client.nthreads().values()))

    @contextmanager
    def _client(self) -> Iterator[Any]:
        """Yield the client of a Dask cluster that is there."""
        with ExitStack() as stack:
            with _naming_what_is_missing('dask', self.scheduler):
                from distributed import Client
                _hush()
                client = stack.enter_context(Client(self.scheduler))
            yield client

    def run(self, call: Callable[[Any], Any], arguments: Sequence[Any],
            instead: Callable[[Any], Any] | None = None) -> Iterator[Any]:
        """Yield what a function returns for each argument, in any order.

        Close the iterator when it is left early, which ends the workers that it started.

        Parameters
        ----------
        call : callable
            Told an argument.
        arguments : sequence
        instead : callable, optional
            Told an argument with which every worker of a Dask cluster dies, returns what is
            yielded for it; DataError at the end without one.
        """
        if not arguments:
            return
        if self.backend == 'dask':
            with self.staying() as there:
                yield from there._on_dask(call, arguments, instead)
            return
        alone = self.backend == LOCAL and self.jobs == 1
        joblib = None if alone else _joblib(required=self != Workers())
        if joblib is None:
            yield from map(call, arguments)
            return
        jobs = self.count()
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

    def _on_dask(self, call: Callable[[Any], Any], arguments: Sequence[Any],
                 instead: Callable[[Any], Any] | None) -> Iterator[Any]:
        """Yield the results of a Dask cluster; what a worker took with it is tried once more."""
        with self._client() as client:
            killed: list[Any] = []
            fatal: list[Any] = []
            yield from _as_they_come(client, call, arguments, killed)
            # By itself: it may have died with another one that shared its worker.
            for argument in killed:
                yield from _as_they_come(client, call, [argument], fatal)
        if instead is not None:
            yield from map(instead, fatal)
        elif fatal:
            # After all others, which can be kept.
            raise DataError(f'every worker that tried it died, as where memory runs out: {fatal}')


def _hush() -> None:
    """Keep to ourselves who talks to whom in a Dask cluster, and that a worker died."""
    logging.getLogger('distributed').setLevel(logging.CRITICAL)


def _as_they_come(client: Any, call: Callable[[Any], Any], arguments: Sequence[Any],
                  killed: list[Any]) -> Iterator[Any]:
    """Yield results of a Dask cluster; arguments that workers died with are added to ``killed``.

    No more is handed out than workers have threads: a worker that dies takes with it all that
    waits there, and results that nobody has fetched.
    """
    from distributed import as_completed, KilledWorker
    waiting, ended = iter(arguments), as_completed()
    running: dict[Any, Any] = {}
    while True:
        n_free = max(1, sum(client.nthreads().values())) - len(running)
        for argument in islice(waiting, max(n_free, 0)):
            # Equal calls are made each: what is kept of them is not Dask's matter.
            future = client.submit(partial(_on_cores, 1, call), argument, pure=False)
            running[future] = argument
            ended.add(future)
        if not running:
            return
        future = next(ended)
        argument = running.pop(future)
        try:
            yield future.result()
        except KilledWorker:
            killed.append(argument)


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
