"""The experiments of Fu et al. 2022: Figures 6, 9 and 10, Tables 1 and 2."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import functools
import itertools
import time

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.dp import PAPER_MS
from track_before_detect.evaluation.engine.report import markdown_table, Quantity, SuiteResult
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.runs import checked_runs, seeds_of
from track_before_detect.evaluation.metrics.confidence import bootstrap_interval
from track_before_detect.evaluation.studies.ring import (
    pictures as ring_pictures,
)
from track_before_detect.evaluation.studies.ring import (
    readings as ring_readings,
)
from track_before_detect.evaluation.studies.ring import (
    runs as ring_runs,
)
from track_before_detect.evaluation.studies.ring.scenes import (
    MULTI_TARGETS,
    MULTI_V_MAX,
    point_frames,
    RING_FRAMES,
    ring_multi,
    RING_SIDE_PX,
    SINGLE_V_MAX,
)
from track_before_detect.models.motion.velocity_candidates import straight_lines, whole_velocities
from track_before_detect.solvers.ring.dynamic_programming import several_targets
from track_before_detect.solvers.ring.merit_functions import merit_functions, METHODS

ORDERS = ('cfo', 'cso', 'mff')
SINGLE_SNRS = (1.5, 1.65, 1.8, 2.0, 2.5, 3.0)
LENGTHS = (20, 50, 100)
MULTI_SNRS = (1.5, 1.8, 2.2, 3.0)
# Frames that times are measured on, and how often; the least counts.
_TIMED_FRAMES, _TIMED = 20, 3
# Best P_d of the plain forms at SNR 1.5 (Section 4.1).
_STATED = {'cfo': ring_readings.STATED, 'cso': 0.3, 'mff': 0.45}
# ms per frame of 128 x 128 px by case, DP and DPR (Table 2).
_TABLE_2 = {'cfo': ('34/65', '34/65', '53/95'), 'cso': ('118/236', '119/237', '175/353'),
            'mff': ('161/315', '155/313', '235/485')}
_COMMON = (f'Frames of {RING_SIDE_PX} x {RING_SIDE_PX} pixels, white noise of one pixel, targets '
           'of one pixel; SNR is the amplitude over the noise of a pixel. ')


def run_ring_single(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Detect single targets by all six methods; arguments as of every suite."""
    checked_runs(runs, seed)
    cells = list(itertools.product(SINGLE_V_MAX, LENGTHS, SINGLE_SNRS))
    items = [{'case': case, 'n_frames': n_frames, 'snr': snr, 'seed': one}
             for case, n_frames, snr in cells
             for one in seeds_of(seed, f'ring-single {case} {n_frames} {snr:g}', runs)]
    results = runner.map(ring_runs.single, items, 'single targets')
    at = (ring_readings.CASE, ring_readings.N_FRAMES, ring_readings.SNR)
    readings = runner.map(
        ring_readings.measure,
        [item for item in items if (item['case'], item['n_frames'], item['snr']) == at],
        'readings of the first order')
    shares = np.array([[result[method] / item['n_frames'] for method in METHODS]
                       for item, result in zip(items, results, strict=True)])
    table = Shares(shares.reshape(len(SINGLE_V_MAX), len(LENGTHS), len(SINGLE_SNRS), runs,
                                  len(METHODS)))
    rows = [{**item, **{method: result[method] / item['n_frames'] for method in METHODS}}
            for item, result in zip(items, results, strict=True)]
    return SuiteResult(
        'Single targets by dynamic programming (Fu et al. 2022, Section 4.1)',
        _COMMON + f'{runs} runs per point (the paper: 1000). Test cases of Figure 5: 1, a line at '
        '(1.2, 1.1) px/frame with v_max = 2; 2, a line at (0.6, 0.8); 3, an arc of 20 px diameter '
        'at 1 px/frame, both with v_max = 1. P_d (Eq. 15) is the share of frames in which the '
        'largest merit function is within a pixel of the target on both axes. "Best" is the best '
        'of all cases and sequence lengths. Intervals: bootstrap over runs, in which the methods '
        'saw the same frames.',
        rows, _single_quantities(table),
        {'runs': runs, 'seed': seed, 'snrs': SINGLE_SNRS, 'lengths': LENGTHS},
        lambda figure: ring_pictures.draw_single(figure, table.means(), table.half_widths(),
                                                 SINGLE_SNRS, LENGTHS, _STATED),
        details='\n\n'.join([_single_details(table), ring_readings.section(readings, {
            _shown(method): float(table.means()[method].ravel()[cells.index(at)])
            for method in ('cso_dp', 'mff_dp')})]))


def run_ring_multi(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Detect several targets by all six methods; arguments as of every suite."""
    checked_runs(runs, seed)
    items = [{'case': case, 'snr': snr, 'n_frames': RING_FRAMES, 'seed': one}
             for case in MULTI_TARGETS for snr in MULTI_SNRS
             for one in seeds_of(seed, f'ring-multi {case} {snr:g}', runs)]
    results = runner.map(ring_runs.multi, items, 'several targets')
    rows, detected, false = [], [], []
    pixels = RING_SIDE_PX**2 * RING_FRAMES
    for item, result in zip(items, results, strict=True):
        points = len(ring_multi(int(item['case']))) * RING_FRAMES
        p_d = {method: result[method][0] / points for method in METHODS}
        p_f = {method: result[method][1] / pixels for method in METHODS}
        detected.append(list(p_d.values()))
        false.append(list(p_f.values()))
        rows.append({**item, **{f'p_d_{method}': value for method, value in p_d.items()},
                     **{f'p_f_{method}': value for method, value in p_f.items()}})
    shape = (len(MULTI_TARGETS), 1, len(MULTI_SNRS), runs, len(METHODS))
    p_d_table, p_f_table = (Shares(np.array(values).reshape(shape))
                            for values in (detected, false))
    return SuiteResult(
        'Several targets by dynamic programming (Fu et al. 2022, Section 4.2)',
        _COMMON + f'{runs} runs per point (the paper: 1000), {RING_FRAMES} frames. Test cases of '
        'Figure 7: 1, two lines that cross; 2, line 1 and an arc of 20 px radius; 3, all three. '
        'The methods are told the number of targets. P_d (Eq. 15): share of the points of targets '
        'within a pixel of a trajectory; P_f (Eq. 16): points of trajectories that are no '
        "target's, over all pixels. Intervals: bootstrap over runs.",
        rows, _multi_quantities(p_d_table, p_f_table),
        {'runs': runs, 'seed': seed, 'snrs': MULTI_SNRS},
        lambda figure: ring_pictures.draw_multi(figure, p_d_table.means(),
                                                p_d_table.half_widths(), MULTI_SNRS),
        {'false_alarms': lambda figure: ring_pictures.draw_false(
            figure, p_f_table.means(), p_f_table.half_widths(), MULTI_SNRS)},
        _multi_details(p_d_table, p_f_table))


class Shares:
    """A share by case, length, SNR, run and method; statistics with intervals over the runs.

    Parameters
    ----------
    values : array, shape (C, L, S, R, M)
        Methods in the order of ``METHODS``.
    """

    def __init__(self, values: NDArray[np.float64]):
        self._by_run = np.moveaxis(values, 3, 0)

    def means(self) -> Mapping[str, NDArray[np.float64]]:
        """Return the mean over runs by method, shape (C, L, S)."""
        return _by_method(self._by_run.mean(axis=0))

    def half_widths(self) -> Mapping[str, NDArray[np.float64]]:
        """Return half of the 95 % interval of each mean, for pictures."""
        runs = len(self._by_run)
        spread = self._by_run.std(axis=0, ddof=1 if runs > 1 else 0)
        return _by_method(1.96 * spread / np.sqrt(runs))

    def quantity(self, name: str, statistic: Callable[[Mapping[str, NDArray]], float],
                 note: str = '', unit: str = '%') -> Quantity:
        """Return a statistic of the means with its interval."""
        return Quantity(
            name, float(statistic(self.means())),
            *bootstrap_interval(self._by_run, lambda drawn: float(
                statistic(_by_method(drawn.mean(axis=0))))),
            len(self._by_run), 'runs', unit, note)


def _by_method(values):
    return {method: values[..., number] for number, method in enumerate(METHODS)}


def _single_quantities(table):
    below = np.flatnonzero(np.array(SINGLE_SNRS) < 2)
    above = np.flatnonzero(np.array(SINGLE_SNRS) > 2)
    at_18 = SINGLE_SNRS.index(1.8)
    quantities = [
        table.quantity(f'best P_d of {order.upper()}-DP at SNR 1.5',
                       lambda p, order=order: p[f'{order}_dp'][..., 0].max(),
                       f'paper: about {100 * _STATED[order]:g} %')
        for order in ORDERS]
    for form, (more, less) in itertools.product(
            ('dp', 'dpr'), (('mff', 'cso'), ('cso', 'cfo'))):
        quantities.append(table.quantity(
            f'{more.upper()}-{form.upper()} minus {less.upper()}-{form.upper()}, mean below SNR 2',
            lambda p, m=f'{more}_{form}', n=f'{less}_{form}': (p[m] - p[n])[..., below].mean(),
            'paper: above 0'))
    for order in ORDERS:
        quantities.append(table.quantity(
            f'largest gain of the ring at SNR 1.8, {order.upper()}',
            lambda p, order=order: (p[f'{order}_dpr'] - p[f'{order}_dp'])[..., at_18].max(),
            'paper: up to 40 points, over all methods'))
    quantities.append(table.quantity(
        'largest gain of the ring anywhere',
        lambda p: max((p[f'{order}_dpr'] - p[f'{order}_dp']).max() for order in ORDERS),
        'paper: up to 40 points'))
    quantities += [
        table.quantity('MFF-DPR at SNR 1.5 with v_max = 2, best length',
                       lambda p: p['mff_dpr'][0, :, 0].max(), 'paper: less than 40 %'),
        table.quantity('CSO-DP minus MFF-DP above SNR 2, case 1, N = 20',
                       lambda p: (p['cso_dp'] - p['mff_dp'])[0, 0, above].max(),
                       'paper: above 0'),
        table.quantity('CSO-DPR minus MFF-DPR above SNR 2, case 1, N = 20',
                       lambda p: (p['cso_dpr'] - p['mff_dpr'])[0, 0, above].max(),
                       'paper: can be above 0'),
        table.quantity('MFF-DPR on the line (case 2) minus the arc (case 3), mean below SNR 2',
                       lambda p: (p['mff_dpr'][1] - p['mff_dpr'][2])[:, below].mean(),
                       'paper: above 0'),
        table.quantity('MFF-DPR with v_max 1 (case 2) minus 2 (case 1), mean below SNR 2',
                       lambda p: (p['mff_dpr'][1] - p['mff_dpr'][0])[:, below].mean(),
                       'paper: above 0')]
    return quantities


def _single_details(table):
    means = table.means()
    lines = ['## Detection probability in per cent', '']
    for case in SINGLE_V_MAX:
        lines += [f'Test case {case}:', '', *markdown_table(
            ('N', 'SNR', *map(_shown, METHODS)),
            [(str(n_frames), f'{snr:g}', *(
                f'{100 * means[method][case - 1, length, number]:.0f}' for method in METHODS))
             for (length, n_frames), (number, snr) in itertools.product(
                 enumerate(LENGTHS), enumerate(SINGLE_SNRS))]), '']
    lines += ['## Table 1: candidates of a step, and milliseconds per frame on one thread', '']
    rows = []
    frames = np.random.default_rng(0).standard_normal(
        (_TIMED_FRAMES, RING_SIDE_PX, RING_SIDE_PX)).astype(np.float32)
    for v_max, order in itertools.product((1, 2), ORDERS):
        candidates = len(whole_velocities(v_max) if order == 'cfo' else straight_lines(v_max))
        seconds = [_least_time(functools.partial(
            merit_functions, frames, f'{order}_{form}', v_max)) for form in ('dp', 'dpr')]
        rows.append((order.upper(), str(v_max), str(candidates), _ms(seconds),
                     '/'.join(map(str, PAPER_MS[order, v_max]))))
    lines += markdown_table(
        ('method', 'v_max', 'candidates', 'DP/DPR, here', 'DP/DPR, paper (i5-2400, MATLAB)'), rows)
    return '\n'.join(lines)


def _multi_quantities(p_d, p_f):
    quantities = []
    for form, (more, less) in itertools.product(
            ('dp', 'dpr'), (('mff', 'cso'), ('cso', 'cfo'))):
        quantities.append(p_d.quantity(
            f'P_d of {more.upper()}-{form.upper()} minus {less.upper()}-{form.upper()}, mean',
            lambda p, m=f'{more}_{form}', n=f'{less}_{form}': (p[m] - p[n]).mean(),
            'paper: above 0'))
    for order in ORDERS:
        quantities.append(p_d.quantity(
            f'gain of the ring in P_d, {order.upper()}, mean',
            lambda p, order=order: (p[f'{order}_dpr'] - p[f'{order}_dp']).mean(),
            'paper: well above 0'))
    for method in METHODS:
        quantities.append(p_f.quantity(
            f'P_f of {_shown(method)} at SNR 3 over that at SNR 1.5, all cases',
            lambda p, method=method: (p[method][..., -1].sum()
                                      / max(p[method][..., 0].sum(), 1e-12)),
            'paper: below 1', ''))
    for order in ORDERS:
        quantities.append(p_f.quantity(
            f'P_f of {order.upper()}-DPR over {order.upper()}-DP above SNR 1.8',
            lambda p, order=order: (p[f'{order}_dpr'][..., 2:].sum()
                                    / max(p[f'{order}_dp'][..., 2:].sum(), 1e-12)),
            'paper: below 1', ''))
    for order in ORDERS:
        quantities.append(p_f.quantity(
            f'P_f of {order.upper()}-DPR over {order.upper()}-DP at SNR 1.5',
            lambda p, order=order: (p[f'{order}_dpr'][..., 0].sum()
                                    / max(p[f'{order}_dp'][..., 0].sum(), 1e-12)),
            'paper: can be above 1', ''))
    quantities.append(p_f.quantity(
        'P_f in case 3 over the mean of cases 1 and 2, all methods',
        lambda p: (sum(p[method][2].sum() for method in METHODS)
                   / max(sum(p[method][:2].sum() / 2 for method in METHODS), 1e-12)),
        'paper: grows with the number of targets', ''))
    return quantities


def _multi_details(p_d, p_f):
    shares, false = p_d.means(), p_f.means()
    lines = ['## Detection probability in per cent / false alarm rate in 1e-6', '']
    rows = []
    for case, (number, snr) in itertools.product(MULTI_TARGETS, enumerate(MULTI_SNRS)):
        rows.append((str(case), f'{snr:g}', *(
            f'{100 * shares[method][case - 1, 0, number]:.0f} / '
            f'{1e6 * false[method][case - 1, 0, number]:.1f}' for method in METHODS)))
    lines += markdown_table(('case', 'SNR', *map(_shown, METHODS)), rows)
    lines += ['', '## Table 2: milliseconds per frame on one thread, all rounds', '']
    rows = []
    for order, case in itertools.product(ORDERS, MULTI_TARGETS):
        truth = ring_multi(case, _TIMED_FRAMES)
        frames = point_frames(np.random.default_rng(0), truth, 3.0, RING_SIDE_PX)
        seconds = [_least_time(functools.partial(
            several_targets, frames, f'{order}_{form}', MULTI_V_MAX, len(truth)))
            for form in ('dp', 'dpr')]
        rows.append((order.upper(), str(case), _ms(seconds), _TABLE_2[order][case - 1]))
    lines += markdown_table(
        ('method', 'case', 'DP/DPR, here', 'DP/DPR, paper (i5-2400, MATLAB)'), rows)
    return '\n'.join(lines)


def _least_time(call):
    """Return the least seconds of this process that a call takes, warm."""
    call()
    seconds = []
    for _ in range(_TIMED):
        began = time.process_time()
        call()
        seconds.append(time.process_time() - began)
    return min(seconds)


def _ms(seconds):
    return '/'.join(f'{1e3 * value / _TIMED_FRAMES:.2f}' for value in seconds)


def _shown(method):
    return method.replace('_', '-').upper()
