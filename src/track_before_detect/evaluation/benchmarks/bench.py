"""How every bench of ``tbd bench`` is carried out and printed."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.engine.machine import describe_machine, machine_line
from track_before_detect.runs.own_process import in_own_process
from track_before_detect.types import Progress

# Of all frames that are measured.
SEED = 1


class Case(Protocol):
    """What is measured at a time."""

    def measure(self, repeats: int) -> dict[str, Any]:
        """Return plain numbers, from so many measurements of each stage."""


class CaseApart(ABC):
    """What is measured in a process of its own, so that its peak memory is its own."""

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure it there; see :class:`Case`."""
        return in_own_process(self.measure_here, repeats)

    @abstractmethod
    def measure_here(self, repeats: int) -> dict[str, Any]:
        """Measure it in this process."""


@dataclass(frozen=True)
class Bench:
    """One bench.

    Attributes
    ----------
    name : str
        Of the command.
    cases : callable
        Told whether to measure large frames too, returns what is measured, in groups.
    lines : callable
        Returns the measurements, by group, as lines of text.
    facts : callable
        Returns what holds for all cases.
    """

    name: str
    cases: Callable[[bool], Mapping[str, Sequence[Case]]]
    lines: Callable[[Mapping[str, Any]], list[str]]
    facts: Callable[[], Mapping[str, Any]] = dict

    def measure(self, repeats: int, large: bool, progress: Progress) -> dict[str, Any]:
        """Return the measurements as plain numbers: times in seconds, memory in bytes.

        Parameters
        ----------
        repeats : int
            Measurements of each stage.
        large : bool
            Whether to measure large frames too, where a bench has them.
        progress : callable
            Called with a label and the share done, 0 to 1.
        """
        if repeats < 1:
            raise ParameterError(f'repeats must be at least 1, got {repeats}')
        groups = self.cases(large)
        measured: dict[str, list[dict[str, Any]]] = {group: [] for group in groups}
        n_all, done = sum(map(len, groups.values())), 0
        for group, cases in groups.items():
            for case in cases:
                progress('measuring', done / n_all)
                measured[group].append(case.measure(repeats))
                done += 1
        progress('measuring', 1.0)
        return {'bench': self.name, 'seed': SEED, 'repeats': repeats,
                'machine': describe_machine(), **self.facts(), **measured}

    def table(self, measured: Mapping[str, Any]) -> str:
        """Return the measurements as text, with the machine they were made on."""
        return '\n'.join([*self.lines(measured), f'{machine_line()}.'])
