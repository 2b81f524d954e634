"""Carries out runs: on all cores or a cluster, and only those not done before.

A run is a function of this package and one item, a mapping that JSON can hold and that decides
everything: parameters of a scene or a recording, method, seed. So the result is the same wherever
and in whatever order runs are carried out.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
import json
from typing import Any

from track_before_detect.runs.kept_results import KeptResults
from track_before_detect.runs.workers import Workers
from track_before_detect.types import Progress

Item = Mapping[str, Any]
Measure = Callable[[Item], Mapping[str, Any]]


@dataclass(frozen=True)
class Runner:
    """Carries out runs.

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
        results: list[dict[str, Any]] = [{}] * len(items)
        for number, result in self.each(measure, items, label):
            results[number] = result
        return results

    def each(self, measure: Measure, items: Sequence[Item], label: str,
             counts: Callable[[Item, Mapping[str, Any]], bool] = lambda item, result: True,
             instead: Callable[[Item], Mapping[str, Any]] | None = None,
             ) -> Generator[tuple[int, dict[str, Any]]]:
        """Yield number and result of each item, those known before first, others as they come.

        Close the iterator when it is left early.

        Parameters
        ----------
        measure, items, label
            As of :meth:`map`.
        counts : callable
            Told an item and what is kept of it, says whether it is not to be run again.
        instead : callable, optional
            Told an item with which every worker dies, returns its result; an error without one.
        """
        known = {} if self.kept is None else self.kept.load(measure)
        # An item that is asked for twice is run once.
        missing: dict[str, tuple[Item, list[int]]] = {}
        n_done = 0
        for number, item in enumerate(items):
            key = as_text(item)
            if key in known and counts(item, known[key]):
                n_done += 1
                yield number, known[key]
            else:
                missing.setdefault(key, (item, []))[1].append(number)
        self.progress(label, n_done / max(len(items), 1))
        with ExitStack() as stack:
            keep = None if self.kept is None else stack.enter_context(self.kept.writer(measure))
            # Closing ends the workers when an error or an interrupt ends the loop.
            results = self.workers.run(_Call(measure), [item for item, _ in missing.values()],
                                       None if instead is None else _Call(instead))
            stack.callback(results.close)  # type: ignore[attr-defined]
            for key, text in results:
                if keep is not None:
                    keep(key, text)
                numbers = missing[key][1]
                n_done += len(numbers)
                self.progress(label, n_done / len(items))
                for number in numbers:
                    yield number, json.loads(text)
        self.progress(label, 1.0)


def as_text(item: Item) -> str:
    """Return an item as text that is the same for equal items."""
    return json.dumps(item, sort_keys=True)


@dataclass(frozen=True)
class _Call:
    """Runs one item in whatever process; results travel as the text that is kept."""

    measure: Measure

    def __call__(self, item: Item) -> tuple[str, str]:
        return as_text(item), json.dumps(self.measure(item))
