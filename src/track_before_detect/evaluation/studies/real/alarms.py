"""How often something passes in real recordings without their targets, beside what was asked."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.pictures import BLUE, GREY, RED, tidy
from track_before_detect.evaluation.engine.quantities import estimate, Quantity
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.metrics.confidence import wilson_interval
from track_before_detect.evaluation.studies.real.alarm_runs import search
from track_before_detect.evaluation.studies.real.labelled import find_recordings
from track_before_detect.tracking.presets import PRESETS

RATES = (0.01, 0.05, 0.2)
# Factors within which the rate is to come of all recordings together, and of each with so many
# batches at least.
TOGETHER, EACH, ENOUGH = 2.0, 4.0, 40
_SCENE = PRESETS['eoir_moving']
LENGTH, HOP = _SCENE['batch_length'], _SCENE['hop']


class Alarms(NamedTuple):
    """Batches of one recording.

    Attributes
    ----------
    counts : list of int
        Those with a trajectory at each rate.
    n_batches : int
        All of them.
    n_apart : int
        As many of them as share no frame.
    """

    counts: list[int]
    n_batches: int
    n_apart: int

    def interval(self, number: int) -> tuple[float, float]:
        """Return that of the share at a rate, as if only batches that share no frame counted."""
        return wilson_interval(
            round(self.counts[number] * self.n_apart / self.n_batches), self.n_apart)


def run_alarms(runs: int, seed: int, runner: Runner, *, data: str,
               rates: Sequence[float] = RATES) -> SuiteResult:
    """Search every recording with truth in a folder without its targets.

    Parameters
    ----------
    runs : int
        How many times as often as in a search a batch begins.
    seed : int
        Of no use: nothing is drawn.
    runner : Runner
        Carries out the runs.
    data : path
        Folder, as of :func:`find_recordings`.
    rates : sequence of float
        False alarm rates that are asked for.
    """
    sources = find_recordings(Path(data))
    hop = max(HOP // runs, 1)
    results = runner.map(
        search, [{'data': str(data), 'recording': name, 'bytes': source.path.stat().st_size,
                  'told': {'hop': hop}, 'rates': list(rates)}
                 for name, source in sources.items()], 'searching recordings without targets')
    batches = {name: result['batches'] for name, result in zip(sources, results, strict=True)
               if result['batches']}
    smallest = {name: np.array([one['rate'] for one in found]) for name, found in batches.items()}
    alarms = {name: Alarms([int((at <= rate).sum()) for rate in rates], len(at),
                           max(len(at) * hop // LENGTH, 1)) for name, at in smallest.items()}
    quantities = [quantity for number, rate in enumerate(rates)
                  for quantity in _quantities(alarms, number, rate)]
    return SuiteResult(
        'False alarms in real recordings, asked for and come',
        f'{len(alarms)} recordings with truth, no option told, without what is known to be in '
        'them: its places in all frames of a batch, grown by five widths of the PSF, are taken '
        'out of the residual. Share of batches in which something passes, beside the '
        f'false_alarm_rate. Batches of {LENGTH} frames begin every {hop} frames and share '
        'frames. Intervals: of all together bootstrap over recordings; of one Wilson, as if only '
        'as many batches counted as share no frame.',
        [{'recording': name, **one} for name, found in batches.items() for one in found],
        quantities, {'data': str(data), 'rates': list(rates), 'hop': hop},
        lambda figure: _draw(figure, alarms, rates))


def _quantities(alarms: Mapping[str, Alarms], number: int, rate: float) -> list[Quantity]:
    """Return the lines of the report of one rate."""
    counted = np.array([(one.counts[number], one.n_batches) for one in alarms.values()])
    asked = f'{100 * rate:g} % requested'
    return [
        estimate(f'all recordings, {asked}', counted, _share, 'batches', '%',
                 _goal(rate, TOGETHER), int(counted[:, 1].sum())),
        *(Quantity(f'{name}, {asked}', one.counts[number] / one.n_batches, *one.interval(number),
                   one.n_batches, 'batches', '%',
                   _goal(rate, EACH) if one.n_batches >= ENOUGH else '')
          for name, one in alarms.items())]


def _share(counted: NDArray) -> float:
    """Return the share of batches with a trajectory in recordings, rows of both numbers."""
    with_one, all_of_them = counted.sum(axis=0)
    return float(with_one / all_of_them)


def _goal(rate: float, factor: float) -> str:
    return f'goal: {100 * rate / factor:.3g} to {min(100 * rate * factor, 100):.3g} %'


def _draw(figure: Any, alarms: Mapping[str, Alarms], rates: Sequence[float]) -> None:
    """Draw what came of all recordings beside what was asked, and of each at every rate."""
    together, *each = figure.subplots(1, 1 + len(rates))
    counted = np.array([(*one.counts, one.n_batches) for one in alarms.values()])
    for number, rate in enumerate(rates):
        pooled = estimate('', counted[:, [number, -1]], _share, '')
        together.plot([rate, rate], [pooled.low, pooled.high], color=BLUE)
        together.plot(rate, pooled.value, 'o', color=BLUE)
    line = np.array([min(rates) / 2, min(2 * max(rates), 1)])
    together.plot(line, line, color=GREY, linewidth=1)
    together.fill_between(line, line / TOGETHER, line * TOGETHER, color=GREY, alpha=0.2)
    together.set(xscale='log', yscale='log', xlabel='false alarm rate requested',
                 ylabel='share of batches, all recordings')
    for number, (axes, rate) in enumerate(zip(each, rates, strict=True)):
        for row, one in enumerate(alarms.values()):
            value, ends = one.counts[number] / one.n_batches, one.interval(number)
            inside = rate / EACH <= value <= rate * EACH
            axes.plot(100 * np.array(ends), [row, row], color=GREY, linewidth=1)
            axes.plot(100 * value, row, 'o', color=BLUE if inside else RED,
                      fillstyle='full' if one.n_batches >= ENOUGH else 'none')
        axes.axvspan(100 * rate / EACH, min(100 * rate * EACH, 100), color=GREY, alpha=0.2)
        axes.set_yticks(range(len(alarms)), list(alarms) if number == 0 else [])
        axes.tick_params(axis='y', labelsize=6)
        axes.set(xscale='symlog', xlim=(0, 100),
                 xlabel=f'batches [%], {100 * rate:g} % requested')
        axes.invert_yaxis()
    tidy((together, *each), grid=False)


SUITE = Suite(
    'Recordings with truth in the folder --data without their targets: how many batches hold '
    'a trajectory beside the rates that were asked for. Batches begin N times as often as in a '
    'search, 2 unless told.', run_alarms, needs_data=True, runs=2)
