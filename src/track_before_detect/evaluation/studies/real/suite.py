"""How methods do on real recordings, as they are and with noise added."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
import math
from pathlib import Path
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.pictures import legend_above, tidy
from track_before_detect.evaluation.engine.quantities import estimate, Quantity, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import seeds_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.engine.tables import markdown_table
from track_before_detect.evaluation.metrics.confidence import poisson_interval
from track_before_detect.evaluation.studies.real.labelled import find_recordings, Source
from track_before_detect.evaluation.studies.real.measures import BOX_MARGIN_PX, NEAR_PX
from track_before_detect.evaluation.studies.real.methods import methods_and_peers
from track_before_detect.evaluation.studies.real.runs import DIMMER, measure

# Single-frame SNR that noise brings a recording to; None leaves it as it is.
SNRS = (None, 4.0, 3.0, 2.0, 1.5)
TIME_LIMIT_S = 300.0
# A recording is followed when this share of its labels is.
FOLLOWED = 0.9

Row = Mapping[str, Any]


def run_real(runs: int, seed: int, runner: Runner, *, data: str,
             methods: Mapping[str, Mapping[str, Any] | None] | None = None,
             snrs: Sequence[float | None] = SNRS,
             time_limit_s: float = TIME_LIMIT_S) -> SuiteResult:
    """Search every recording with truth in a folder by every method.

    Parameters
    ----------
    runs : int
        Searches of each recording with different noise, for each SNR; as it is it is searched
        once.
    seed : int
        Every noise gets a seed of its own from this one.
    runner : Runner
        Carries out the runs.
    data : path
        Folder, as of :func:`find_recordings`.
    methods : mapping, optional
        Options of the detector by the name of the method, None of a peer; all methods and the
        peers that are installed unless given.
    snrs : sequence of float or None
        SNR to bring recordings to by added noise; None leaves them as they are.
    time_limit_s : float
        After this time a run is ended and has found nothing, loading included.
    """
    sources = find_recordings(Path(data))
    methods = methods_and_peers() if methods is None else methods
    items = [
        {'data': str(data), 'recording': name, 'bytes': source.path.stat().st_size,
         'method': method, 'options': options if options is None else dict(options),
         'snr': snr, 'seed': one, 'time_limit_s': time_limit_s}
        for name, source in sources.items() for method, options in methods.items()
        for snr in snrs
        for one in ([0] if snr is None else seeds_of(seed, f'{name} {snr:g}', runs))]
    rows = runner.map(measure, items, 'searching real recordings')
    made = [row for row in rows if row['status'] != DIMMER]
    levels = {(method, snr): [row for row in made if (row['method'], row['snr']) == (method, snr)]
              for method in methods for snr in snrs}
    levels = {key: level for key, level in levels.items() if level}
    return SuiteResult(
        'Real recordings',
        f'{len(sources)} recordings with truth, as they are and with white Gaussian noise added '
        'until the median SNR of their targets in a single frame (peak over the local standard '
        f'deviation) is what is said ({runs} times each). A target is followed in a frame where '
        f'a trajectory is within {NEAR_PX:g} px of it, or in its box grown by '
        f'{BOX_MARGIN_PX:g} px; a trajectory is false when it is elsewhere in more than half of '
        'its frames. P_d and F_a count pixels as learned detectors are measured: a hit within 1 '
        'px of a pixel of the target, a false pixel more than 4 px from all. A run without an '
        f'answer after {time_limit_s:g} s has found nothing. Intervals: bootstrap over '
        'recordings for means and medians, Wilson for shares, Poisson for counts.',
        rows, [quantity for (method, snr), level in levels.items()
               for quantity in _quantities(_title(method, snr), level, snr is None)],
        {'data': str(data), 'methods': methods, 'snrs': list(snrs), 'time_limit_s': time_limit_s},
        lambda figure: _draw(figure, levels),
        details='\n'.join(_details(levels, sources)))


def _title(method: str, snr: float | None) -> str:
    return f'{method}, as it is' if snr is None else f'{method}, SNR {snr:g}'


def _of_recordings(rows: Sequence[Row], measured: str) -> np.ndarray:
    """Return one number for each recording that has it: the mean over its runs."""
    values = defaultdict(list)
    for row in rows:
        if not math.isnan(row[measured]):
            values[row['recording']].append(row[measured])
    return np.array([np.mean(numbers) for numbers in values.values()])


def _quantities(title: str, rows: Sequence[Row], with_all: bool) -> list[Quantity]:
    """Return the lines of the report of one method and SNR."""

    def over_recordings(name: str, measured: str, statistic: Callable, unit: str = '') -> Quantity:
        values = _of_recordings(rows, measured)
        if not len(values):
            nan = float('nan')
            return Quantity(f'{title}: {name}', nan, nan, nan, 0, 'recordings', unit)
        return estimate(f'{title}: {name}', values, lambda drawn: float(statistic(drawn)),
                        'recordings', unit)

    followed = _of_recordings(rows, 'followed')
    n_false = sum(row['n_false'] for row in rows)
    n_batches = sum(row['n_batches'] for row in rows)
    answered = sum(row['n_batches'] > 0 for row in rows)
    quantities = [
        share(f'{title}: recordings followed in {100 * FOLLOWED:g} % of their frames',
              int((followed >= FOLLOWED).sum()), len(followed), 'recordings'),
        over_recordings('frames followed', 'followed', np.mean, '%')]
    if n_batches:
        quantities.append(Quantity(
            f'{title}: false trajectories per batch', n_false / n_batches,
            *poisson_interval(n_false, n_batches), n_batches, 'batches'))
    if answered < len(rows):
        quantities.append(share(f'{title}: runs with an answer', answered, len(rows), 'runs'))
    if not with_all:
        return quantities
    return quantities + [
        over_recordings('false trajectories per minute', 'false_per_minute', np.mean),
        over_recordings('trajectories per target', 'ids_per_target', np.mean),
        over_recordings('frames to the first detection', 'first_detection_frames', np.median),
        over_recordings('P_d', 'p_d', np.mean, '%'),
        over_recordings('F_a', 'f_a', np.mean),
        over_recordings('position RMSE', 'rmse_px', np.median, 'px'),
        over_recordings('time per frame', 'seconds_per_frame', np.median, 's')]


def _details(levels: Mapping[tuple[str, float | None], Sequence[Row]],
             sources: Mapping[str, Source]) -> list[str]:
    """Return a table of the recordings as they are for each method, and P_d and F_a by group."""
    lines: list[str] = []
    groups = []
    for (method, snr), rows in levels.items():
        if snr is not None:
            continue
        lines += [f'## {_title(method, snr)}', '', *markdown_table(
            ['recording', 'followed', 'false per batch', 'trajectories per target',
             'first detection [frames]', 'RMSE [px]', 's per frame', 'status'],
            [[row['recording'], f'{100 * row["followed"]:.1f} %',
              *(_shown(row[key]) for key in (
                  'false_per_batch', 'ids_per_target', 'first_detection_frames', 'rmse_px',
                  'seconds_per_frame')), row['status']] for row in rows]), '']
        for group in dict.fromkeys(source.group for source in sources.values()):
            inside = [row for row in rows if sources[row['recording']].group == group]
            p_d, f_a = (_of_recordings(inside, key) for key in ('p_d', 'f_a'))
            groups.append([group, method, str(len(inside)),
                           *(_shown(float(values.mean()) if len(values) else float('nan'))
                             for values in (100 * p_d, 1e5 * f_a))])
    return lines + ['## P_d and F_a by pixels', '', *markdown_table(
        ['recordings', 'method', 'number', 'P_d [%]', 'F_a [1e-5]'], groups)]


def _shown(value: float) -> str:
    return '–' if math.isnan(value) else f'{value:.3g}'


def _draw(figure: Any, levels: Mapping[tuple[str, float | None], Sequence[Row]]) -> None:
    """Draw the frames followed in each recording, and how many are followed over the SNR."""
    single, over_snr = figure.subplots(1, 2)
    by_method: dict[str, dict[float | None, Sequence[Row]]] = defaultdict(dict)
    for (method, snr), rows in levels.items():
        by_method[method][snr] = rows
    markers = 'osD^vP*X'
    for k, (method, of_snr) in enumerate(by_method.items()):
        # Hollow and of different sizes: what lies on one place stays to be seen.
        look = {'marker': markers[k % len(markers)], 'markersize': 5 + 2 * k, 'fillstyle': 'none'}
        as_is = of_snr.get(None, [])
        single.plot([100 * row['followed'] for row in as_is],
                    [row['recording'] for row in as_is], label=method, linestyle='none', **look)
        degraded = {snr: _of_recordings(rows, 'followed') for snr, rows in of_snr.items()
                    if snr is not None}
        over_snr.plot(list(degraded), [100 * values.mean() for values in degraded.values()],
                      label=method, **look)
    single.set(xlim=(-3, 103), xlabel='frames followed, recording as it is [%]')
    single.invert_yaxis()
    single.tick_params(axis='y', labelsize=7)
    over_snr.set(ylim=(-3, 103), xlabel='single-frame SNR after noise is added',
                 ylabel='frames followed, mean over recordings [%]')
    legend_above(figure, len(by_method), single.get_lines())
    tidy((single, over_snr), grid=False)


SUITE = Suite(
    'Recordings with truth in the folder --data, as they are and with noise added to SNR 4 to 1.5 '
    '(N times, 1 unless told): frames followed, false trajectories, P_d and F_a by pixels, time.',
    run_real, needs_data=True, runs=1, methods=methods_and_peers)
