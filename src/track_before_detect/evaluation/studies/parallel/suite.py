"""The experiments of Guo et al. 2018: Figures 9 and 10, and the cost ratio of Eq. 18."""

from collections.abc import Mapping, Sequence
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine import pictures
from track_before_detect.evaluation.engine.quantities import estimate, mean, Quantity, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.engine.tables import markdown_table
from track_before_detect.evaluation.metrics.confidence import wilson_interval
from track_before_detect.evaluation.studies.parallel import runs as parallel_runs
from track_before_detect.evaluation.studies.parallel import scenes
from track_before_detect.evaluation.studies.parallel.runs import METHODS
from track_before_detect.models.motion.transition_sets import directional_sets

SNRS_DB = tuple(range(4, 16))
# Where the text says that PC is better, and where the six targets are drawn in Figures 7 and 8.
MIDDLE_DB = (5, 9)
SHOWN_DB = 8
P_FA = 0.1
# Batches of noise for each run of a point; a batch takes a millisecond.
NOISE_PER_RUN = 10
N_TARGETS = len(scenes.SIX_STATES)
_KINDS = ('crosses 2', 'crosses 1', 'alone', 'beside 5', 'beside 4', 'alone')
_COLOURS = {'mt_dp': pictures.GREY, 'pc_dp': pictures.RED}
_STYLES = {'mt_dp': '--', 'pc_dp': '-'}


def run_parallel(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Search the six-target scene by ``mt_dp`` and ``pc_dp``."""
    thresholds = {name: runner.threshold(
        {'detector': name, **scenes.OPTIONS, 'false_alarm_rate': P_FA},
        (scenes.N_FRAMES, *scenes.SHAPE)) for name in METHODS}
    items = [item for snr in SNRS_DB for item in items_of(
        seed, f'parallel {snr}', runs, snr_db=snr, thresholds=thresholds)]
    results = runner.map(parallel_runs.six_targets, items, 'six targets')
    noise = runner.map(
        parallel_runs.noise,
        items_of(seed, 'parallel noise', NOISE_PER_RUN * runs, thresholds=thresholds),
        'searching noise')
    table = _Table(results, runs)
    rows = [{'snr_db': item['snr_db'], 'seed': item['seed'], 'method': name,
             'n_tracks': result[name]['n_tracks'],
             'candidates': sum(result[name]['candidates']),
             'candidates_of_slowest': max(result[name]['candidates']),
             **{f'error_{number + 1}': float('nan') if error is None else error**0.5
                for number, error in enumerate(result[name]['squared_error'])}}
            for item, result in zip(items, results, strict=True) for name in METHODS]
    return SuiteResult(
        'Target cancellation, whole and by direction (Guo et al. 2018, Section 4)',
        f'Six frames of 50 x 50 cells, complex noise, six point targets with random phases; SNR '
        f'is 10 log10(A^2 / sigma^2). {runs} runs per point (the paper: 1000), threshold of each '
        f'method for P_fa = {P_FA:g} per batch; candidates within one cell. Detected: the track '
        'ends within two cells of that of the target on both axes, one track for one target. '
        'RMSE: distance of valid tracks to the cells of their targets, over all frames. The merit '
        'is |h|^2; the process noise, which the text leaves open, is zero. Intervals: Wilson for '
        'shares, bootstrap over runs for differences, errors and ratios, in which both methods '
        'saw the same frames.',
        rows, _quantities(table, noise, runs),
        {'thresholds': thresholds, 'p_fa': P_FA},
        functools.partial(_draw, table=table),
        {'rmse': functools.partial(_draw_rmse, table=table)}, _details(table))


class _Table:
    """Results by SNR, run and method."""

    def __init__(self, results: Sequence[Mapping[str, Any]], runs: int):
        def gathered(name: str, key: str) -> NDArray[np.float64]:
            """Return a result by SNR, run, and target or direction."""
            return np.array([result[name][key] for result in results], float).reshape(
                len(SNRS_DB), runs, -1)

        def of_both(key: str) -> NDArray[np.float64]:
            return np.stack([gathered(name, key) for name in METHODS], axis=2)

        self.detected = of_both('detected')
        self.squared_error = of_both('squared_error')
        self.n_tracks = of_both('n_tracks')[..., 0]
        # By SNR and run: the candidates of the slowest direction and of all over those of mt_dp,
        # Eq. 18 with the targets that were found, and the same if all is computed anew after each
        # of them: parts that share their borders, and one search more that finds nothing.
        candidates, found = (gathered('pc_dp', key) for key in ('candidates', 'found'))
        whole = gathered('mt_dp', 'candidates').sum(axis=2)
        self.slowest = candidates.max(axis=2) / whole
        self.total = candidates.sum(axis=2) / whole
        self.n_directions = found.shape[2]
        most, all_found = found.max(axis=2), gathered('mt_dp', 'found')[..., 0]
        self.stated = most / (np.maximum(all_found, 1) * self.n_directions)
        self.anew = (most + 1) / (all_found + 1) * largest_part(self.n_directions)


def _rmse(squared: NDArray) -> float:
    """Return the root of the mean over all that is known; NaN where nothing is."""
    return float(np.sqrt(np.nanmean(squared))) if np.isfinite(squared).any() else np.nan


def largest_part(n_directions: int) -> float:
    """Return what part of the transition set a direction has, at one cell per frame."""
    whole, = directional_sets([1], 1)
    return max(int(part.sizes[0]) for part in directional_sets([1], n_directions)) / int(
        whole.sizes[0])


def _quantities(table: _Table, noise: Sequence[Mapping[str, bool]], runs: int) -> list[Quantity]:
    low, high = (SNRS_DB.index(end) for end in MIDDLE_DB)
    middle, names = slice(low, high + 1), list(METHODS)
    mt, pc = names.index('mt_dp'), names.index('pc_dp')
    n_middle = runs * (high + 1 - low)
    # By SNR, run and target.
    gain = table.detected[:, :, pc] - table.detected[:, :, mt]
    quantities = [
        mean(f'P_d of PC minus MT, 5 to 9 dB, target {target + 1} ({_KINDS[target]})',
             gain[middle, :, target].mean(axis=0), 'runs', '%',
             'paper: obviously above 0' if target < 2 else 'paper: above 0', n_middle)
        for target in range(N_TARGETS)]
    quantities.append(mean('P_d of PC minus MT, all SNRs and targets', gain.mean(axis=(0, 2)),
                           'runs', '%', 'paper: above 0, generally', runs * len(SNRS_DB)))
    squared = np.moveaxis(table.squared_error[middle], 1, 0)
    for label, targets in (('targets 1 and 2', slice(0, 2)), ('all targets', slice(None))):
        quantities.append(estimate(
            f'RMSE of PC over MT, 5 to 9 dB, {label}', squared[..., targets],
            lambda drawn: _rmse(drawn[:, :, pc]) / _rmse(drawn[:, :, mt]), 'runs',
            note='paper: much smaller', trials=n_middle))
    for number, name in enumerate(names):
        hits = table.detected[-1, :, number]
        quantities.append(share(f'P_d at 15 dB, all targets, {name}', int(hits.sum()), hits.size,
                                'targets', 'paper: valid detection'))
    quantities += [
        share(f'noise batches with a track, {name}', sum(result[name] for result in noise),
              len(noise), 'batches', f'requested: {100 * P_FA:g} %') for name in METHODS]
    shown = SNRS_DB.index(SHOWN_DB)
    for label, values, note in (
            ('slowest direction of PC over MT', table.slowest, 'paper: at most 1/4'),
            ('all directions of PC over MT', table.total, ''),
            ('Eq. 18 with the targets found', table.stated, 'paper: at most 1/4'),
            ('the same with shared borders and the last search', table.anew,
             'computed, not counted; see below')):
        quantities.append(mean(f'candidates at {SHOWN_DB} dB, {label}', values[shown], 'runs',
                               note=note))
    return quantities


def _details(table: _Table) -> str:
    lines = ['## Detection probability in per cent and RMSE in cells, MT / PC', '']
    rows: list[list[str]] = []
    for number, snr in enumerate(SNRS_DB):
        row = [str(snr)]
        for target in range(N_TARGETS):
            shares = table.detected[number, :, :, target].mean(axis=0)
            errors = [_rmse(table.squared_error[number, :, method, target])
                      for method in range(len(METHODS))]
            row.append(f'{100 * shares[0]:.0f} / {100 * shares[1]:.0f}, '
                       + ' / '.join('-' if np.isnan(error) else f'{error:.2f}'
                                    for error in errors))
        tracks = table.n_tracks[number].mean(axis=0)
        rows.append([*row, f'{tracks[0]:.1f} / {tracks[1]:.1f}'])
    lines += markdown_table(
        ('SNR [dB]', *(f'target {number + 1}' for number in range(N_TARGETS)), 'tracks'), rows)
    return '\n'.join([*lines, '', *_cost(table)])


def _cost(table: _Table) -> list[str]:
    """Say why the measured cost is not that of Eq. 18."""
    shown = SNRS_DB.index(SHOWN_DB)
    slowest, stated, anew = (values[shown].mean() for values in (
        table.slowest, table.stated, table.anew))
    part = largest_part(table.n_directions)
    return ['## Cost beside Eq. 18', '', (
        f'Eq. 17 gives each of {table.n_directions} directions 1/{table.n_directions} of the '
        'transition set. Neighbouring directions share their borders, as Section 3.2.1 says, so '
        f'at one cell per second each has {part:.3f} of it. Eq. 18 also counts one search per '
        'target, while one more has to be made to know that nothing is left. With both, the '
        f'targets found at {SHOWN_DB} dB make {anew:.3f} out of the {stated:.3f} of Eq. 18. Both '
        'methods here compute again only what a cancelled target reaches, which spares most of '
        'the searches after the first: so the first one, of which a direction has '
        f'{part:.3f}, weighs most, and {slowest:.3f} is counted.')]


def _panels(figure: Any, label: str) -> NDArray:
    """Return one panel for each target, and explain the lines of both methods."""
    figure.set_size_inches(11, 6.5)
    panels = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    pictures.tidy(panels)
    for number, axes in enumerate(panels):
        axes.set_title(f'target {number + 1}, {_KINDS[number]}', fontsize='medium')
    for axes in panels[3:]:
        axes.set_xlabel('SNR [dB]')
    for axes in panels[::3]:
        axes.set_ylabel(label)
    pictures.legend_above(figure, 2, [
        pictures.key(panels[0], name, _STYLES[name], color=_COLOURS[name]) for name in METHODS])
    return panels


def _draw(figure: Any, table: _Table) -> None:
    """Draw Figure 9."""
    panels = _panels(figure, 'detection probability [%]')
    runs = table.detected.shape[1]
    for target, axes in enumerate(panels):
        for number, name in enumerate(METHODS):
            counts = table.detected[:, :, number, target].sum(axis=1)
            ends = np.array([wilson_interval(int(count), runs) for count in counts])
            pictures.draw_band(axes, SNRS_DB, 100 * counts / runs, 100 * ends.T, _COLOURS[name],
                      _STYLES[name], 0.2)
    panels[0].set_ylim(0, 100)


def _draw_rmse(figure: Any, table: _Table) -> None:
    """Draw Figure 10."""
    panels = _panels(figure, 'RMSE of valid tracks [cells]')
    for target, axes in enumerate(panels):
        for number, name in enumerate(METHODS):
            errors = [_rmse(table.squared_error[point, :, number, target])
                      for point in range(len(SNRS_DB))]
            axes.plot(SNRS_DB, errors, _STYLES[name], color=_COLOURS[name])
    panels[0].set_ylim(bottom=0)


SUITE = Suite(
    'The six targets of Guo et al. 2018 by mt_dp and pc_dp, 4 to 15 dB: Figures 9 and 10, and '
    'the cost ratio of Eq. 18 (N runs a point, 12 points).', run_parallel)
