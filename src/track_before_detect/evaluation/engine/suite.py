"""A study that can be repeated, and what it hands over."""

from collections.abc import Callable, Mapping, Sequence
import dataclasses
from dataclasses import dataclass, field
from typing import Any

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.engine.runner import Runner


@dataclass(frozen=True)
class SuiteResult:
    """What a suite found out.

    Attributes
    ----------
    title : str
        Heading of the report.
    description : str
        What was done, in a few sentences.
    rows : list of dict
        One per run, all with the same keys.
    quantities : list of Quantity
        The table of the report.
    settings : mapping
        What the runs were made with, beside their number and seed.
    draw : callable
        Draws the picture into a matplotlib figure.
    pictures : mapping
        Further pictures: what the name of the file ends in, and what draws it.
    details : str
        More of the report, in Markdown, after the pictures.
    """

    title: str
    description: str
    rows: list[dict[str, Any]]
    quantities: list[Quantity]
    settings: Mapping[str, Any]
    draw: Callable[[Any], None]
    pictures: Mapping[str, Callable[[Any], None]] = field(default_factory=dict)
    details: str = ''


@dataclass(frozen=True)
class Suite:
    """A study that can be repeated.

    Attributes
    ----------
    description : str
        What it finds out.
    study : callable
        Told the number of runs, the seed and a Runner, which have been checked; told ``data``,
        too, if it needs them.
    needs_data : bool
        Whether it is made of recordings in a folder, not of simulated ones.
    runs : int
        How often it is repeated unless said otherwise.
    methods : callable, optional
        Of a study of which methods may be left out: returns those of the names it is told, as the
        study takes them.
    """

    description: str
    study: Callable[..., SuiteResult]
    needs_data: bool = False
    runs: int = 100
    methods: Callable[[Sequence[str]], Mapping[str, Any]] | None = None

    def run(self, runs: int, seed: int, runner: Runner, data: str | None = None,
            methods: Sequence[str] = ()) -> SuiteResult:
        """Carry out the study.

        Parameters
        ----------
        runs : int
            How often it is repeated, at least 1.
        seed : int
            Not negative; every run gets a seed of its own from it.
        runner : Runner
            Carries out the runs.
        data : str, optional
            Folder of recordings with truth, of a study that needs it and of no other.
        methods : sequence of str
            Those that are compared; all unless given.
        """
        if runs < 1:
            raise ParameterError(f'runs must be at least 1, got {runs}')
        if seed < 0:
            raise ParameterError(f'seed must not be negative, got {seed}')
        if self.needs_data != (data is not None):
            raise ParameterError(
                '--data, a folder of recordings with truth, is for studies of real recordings '
                f'alone; this one {"needs it" if self.needs_data else "simulates its own"}')
        told: dict[str, Any] = {} if data is None else {'data': data}
        if methods:
            if self.methods is None:
                raise ParameterError(
                    '--methods is for studies that can do with some of their methods; this one '
                    f'has none to leave out, got {", ".join(methods)}')
            told['methods'] = self.methods(methods)
        result = self.study(runs, seed, runner, **told)
        return dataclasses.replace(
            result, settings={'runs': runs, 'seed': seed, **result.settings})
