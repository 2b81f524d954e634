"""The experiments of Guo et al. 2018: Figures 9 and 10, and the cost ratio of Eq. 18."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.report import (
    markdown_table,
    Quantity,
    share,
    SuiteResult,
)
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.runs import checked_runs, seeds_of
from track_before_detect.evaluation.metrics.confidence import bootstrap_interval, wilson_interval
from track_before_detect.evaluation.studies.parallel import (
    runs as parallel_runs,
)
from track_before_detect.evaluation.studies.parallel import (
    scenes as parallel_scenes,
)
from track_before_detect.evaluation.studies.parallel.runs import METHODS, STAMPS
from track_before_detect.models.motion.transition_sets import directional_sets

SNRS_DB = tuple(range(4, 16))
# Where the text says that PC is better, and where the six targets are drawn in Figures 7 and 8.
MIDDLE_DB = (5, 9)
SHOWN_DB = 8
P_FA = 0.1
# Batches of noise for each run of a point; a batch takes a millisecond.
NOISE_PER_RUN = 10
N_TARGETS = len(parallel_scenes.SIX_STATES)
_KINDS = ('crosses 2', 'crosses 1', 'alone', 'beside 5', 'beside 4', 'alone')
_COLOURS = {'mt_dp': '#8c8c8c', 'pc_dp': '#d62728'}
_STYLES = {'mt_dp': '--', 'pc_dp': '-'}


def run_parallel(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Search the six-target scene by ``mt_dp`` and ``pc_dp``; arguments as of every suite."""
    checked_runs(runs, seed)
    thresholds = {
        name: detector(parallel_runs.options(name, false_alarm_rate=P_FA)).threshold(
            STAMPS, parallel_scenes.SHAPE, runner.progress)
        for name, detector in METHODS.items()}
    items = [{'snr_db': snr, 'thresholds': thresholds, 'seed': one} for snr in SNRS_DB
             for one in seeds_of(seed, f'parallel {snr}', runs)]
    results = runner.map(parallel_runs.six_targets, items, 'six targets')
    noise = runner.map(
        parallel_runs.noise, [{'thresholds': thresholds, 'seed': one}
                              for one in seeds_of(seed, 'parallel noise', NOISE_PER_RUN * runs)],
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
        {'runs': runs, 'seed': seed, 'thresholds': thresholds, 'p_fa': P_FA},
        lambda figure: _draw(figure, table, runs),
        {'rmse': lambda figure: _draw_rmse(figure, table)}, _details(table))


class _Table:
    """Results by SNR, run and method."""

    def __init__(self, results, runs):
        shape = (len(SNRS_DB), runs, len(METHODS), -1)

        def gathered(key):
            return np.array([[result[name][key] for name in METHODS] for result in results],
                            float).reshape(shape)

        self.detected = gathered('detected')
        self.squared_error = gathered('squared_error')
        self.n_tracks = gathered('n_tracks')[..., 0]
        each: dict[str, dict[str, NDArray]] = {
            name: {key: np.array([result[name][key] for result in results], float).reshape(
                len(SNRS_DB), runs, -1) for key in ('found', 'candidates')} for name in METHODS}
        # By SNR and run: the candidates of the slowest direction and of all over those of mt_dp,
        # Eq. 18 with the targets that were found, and the same if all is computed anew after each
        # of them: parts that share their borders, and one search more that finds nothing.
        whole = each['mt_dp']['candidates'].sum(axis=2)
        self.slowest = each['pc_dp']['candidates'].max(axis=2) / whole
        self.total = each['pc_dp']['candidates'].sum(axis=2) / whole
        self.n_directions = n_directions = each['pc_dp']['found'].shape[2]
        most, all_found = each['pc_dp']['found'].max(axis=2), each['mt_dp']['found'][..., 0]
        self.stated = most / (np.maximum(all_found, 1) * n_directions)
        self.anew = (most + 1) / (all_found + 1) * largest_part(n_directions)

    def rmse(self, squared):
        """Return the root of the mean over the first axis and over what is left, NaN left out."""
        return float(np.sqrt(np.nanmean(squared))) if np.isfinite(squared).any() else np.nan


def largest_part(n_directions: int) -> float:
    """Return what part of the transition set a direction has, at one cell per frame."""
    whole, = directional_sets([1], 1)
    return max(int(part.sizes[0]) for part in directional_sets([1], n_directions)) / int(
        whole.sizes[0])


def _quantities(table, noise, runs):
    low, high = (SNRS_DB.index(end) for end in MIDDLE_DB)
    middle, names = slice(low, high + 1), list(METHODS)
    mt, pc = names.index('mt_dp'), names.index('pc_dp')
    quantities = []
    for target in range(N_TARGETS):
        # By run, over the points between 5 and 9 dB.
        detected = table.detected[middle, :, :, target].mean(axis=0)
        gain = detected[:, pc] - detected[:, mt]
        quantities.append(Quantity(
            f'P_d of PC minus MT, 5 to 9 dB, target {target + 1} ({_KINDS[target]})',
            float(gain.mean()), *bootstrap_interval(gain, lambda drawn: float(drawn.mean())),
            runs * (high + 1 - low), 'runs', '%',
            'paper: obviously above 0' if target < 2 else 'paper: above 0'))
    gain = (table.detected[:, :, pc] - table.detected[:, :, mt]).mean(axis=(0, 2))
    quantities.append(Quantity(
        'P_d of PC minus MT, all SNRs and targets', float(gain.mean()),
        *bootstrap_interval(gain, lambda drawn: float(drawn.mean())), runs * len(SNRS_DB), 'runs',
        '%', 'paper: above 0, generally'))
    squared = np.moveaxis(table.squared_error[middle], 1, 0)
    for label, targets in (('targets 1 and 2', slice(0, 2)), ('all targets', slice(None))):
        def ratio(drawn, targets=targets):
            return table.rmse(drawn[:, :, pc, targets]) / table.rmse(drawn[:, :, mt, targets])

        quantities.append(Quantity(
            f'RMSE of PC over MT, 5 to 9 dB, {label}', ratio(squared),
            *bootstrap_interval(squared, ratio), runs * (high + 1 - low), 'runs',
            note='paper: much smaller'))
    for name in METHODS:
        hits = table.detected[-1, :, names.index(name)]
        quantities.append(share(f'P_d at 15 dB, all targets, {name}', int(hits.sum()), hits.size,
                                'targets', 'paper: valid detection'))
    for name in METHODS:
        quantities.append(share(f'noise batches with a track, {name}',
                                sum(result[name] for result in noise), len(noise), 'batches',
                                f'requested: {100 * P_FA:g} %'))
    shown = SNRS_DB.index(SHOWN_DB)
    for label, values, note in (
            ('slowest direction of PC over MT', table.slowest, 'paper: at most 1/4'),
            ('all directions of PC over MT', table.total, ''),
            ('Eq. 18 with the targets found', table.stated, 'paper: at most 1/4'),
            ('the same with shared borders and the last search', table.anew,
             'computed, not counted; see below')):
        quantities.append(Quantity(
            f'candidates at {SHOWN_DB} dB, {label}', float(values[shown].mean()),
            *bootstrap_interval(values[shown], lambda drawn: float(drawn.mean())), runs, 'runs',
            note=note))
    return quantities


def _details(table):
    lines = ['## Detection probability in per cent and RMSE in cells, MT / PC', '']
    rows: list[list[str]] = []
    for number, snr in enumerate(SNRS_DB):
        row = [str(snr)]
        for target in range(N_TARGETS):
            shares = table.detected[number, :, :, target].mean(axis=0)
            errors = [table.rmse(table.squared_error[number, :, method, target])
                      for method in range(len(METHODS))]
            row.append(f'{100 * shares[0]:.0f} / {100 * shares[1]:.0f}, '
                       + ' / '.join('-' if np.isnan(error) else f'{error:.2f}'
                                    for error in errors))
        tracks = table.n_tracks[number].mean(axis=0)
        rows.append([*row, f'{tracks[0]:.1f} / {tracks[1]:.1f}'])
    lines += markdown_table(
        ('SNR [dB]', *(f'target {number + 1}' for number in range(N_TARGETS)), 'tracks'), rows)
    return '\n'.join([*lines, '', *_cost(table)])


def _cost(table):
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


def _panels(figure, label) -> Any:
    figure.set_size_inches(11, 6.5)
    panels = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    for number, axes in enumerate(panels):
        axes.set_title(f'target {number + 1}, {_KINDS[number]}', fontsize='medium')
        axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)
    for axes in panels[3:]:
        axes.set_xlabel('SNR [dB]')
    for axes in panels[::3]:
        axes.set_ylabel(label)
    return panels


def _legend(figure, axes):
    handles = [axes.plot([], [], _STYLES[name], color=_COLOURS[name], label=name)[0]
               for name in METHODS]
    figure.legend(handles=handles, loc='outside upper center', ncols=2, frameon=False)


def _draw(figure, table, runs):
    """Draw Figure 9."""
    panels = _panels(figure, 'detection probability [%]')
    for target, axes in enumerate(panels):
        for number, name in enumerate(METHODS):
            counts = table.detected[:, :, number, target].sum(axis=1)
            ends = np.array([wilson_interval(int(count), runs) for count in counts])
            axes.plot(SNRS_DB, 100 * counts / runs, _STYLES[name], color=_COLOURS[name])
            axes.fill_between(SNRS_DB, *(100 * ends.T), color=_COLOURS[name], alpha=0.2,
                              linewidth=0)
    panels[0].set_ylim(0, 100)
    _legend(figure, panels[0])


def _draw_rmse(figure, table):
    """Draw Figure 10."""
    panels = _panels(figure, 'RMSE of valid tracks [cells]')
    for target, axes in enumerate(panels):
        for number, name in enumerate(METHODS):
            errors = [table.rmse(table.squared_error[point, :, number, target])
                      for point in range(len(SNRS_DB))]
            axes.plot(SNRS_DB, errors, _STYLES[name], color=_COLOURS[name])
    panels[0].set_ylim(bottom=0)
    _legend(figure, panels[0])
