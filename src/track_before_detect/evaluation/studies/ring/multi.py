"""Two and three targets by the six methods of Fu et al. 2022: Figures 9 and 10 and Table 2."""

import functools
import itertools

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.engine.tables import markdown_table
from track_before_detect.evaluation.studies.ring import pictures, scenes, shares
from track_before_detect.evaluation.studies.ring import runs as ring_runs
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.solvers.ring.several_targets import several_targets

SNRS = (1.5, 1.8, 2.2, 3.0)
# ms per frame of 128 x 128 px by case, DP and DPR (Table 2).
_TABLE_2 = {'cfo': ('34/65', '34/65', '53/95'), 'cso': ('118/236', '119/237', '175/353'),
            'mff': ('161/315', '155/313', '235/485')}


def run_ring_multi(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Detect several targets by all six methods."""
    items = [item for case in scenes.MULTI_TARGETS for snr in SNRS for item in items_of(
        seed, f'ring-multi {case} {snr:g}', runs, case=case, snr=snr,
        n_frames=scenes.N_FRAMES)]
    results = runner.map(ring_runs.multi, items, 'several targets')
    rows = []
    for item, result in zip(items, results, strict=True):
        points = len(scenes.MULTI_TARGETS[item['case']]) * scenes.N_FRAMES
        pixels = scenes.SIDE_PX**2 * scenes.N_FRAMES
        rows.append({**item,
                     **{f'p_d_{method}': result[method][0] / points for method in METHODS},
                     **{f'p_f_{method}': result[method][1] / pixels for method in METHODS}})
    p_d, p_f = (shares.Shares(np.array([
        [row[f'{kind}_{method}'] for method in METHODS] for row in rows]).reshape(
            len(scenes.MULTI_TARGETS), 1, len(SNRS), runs, len(METHODS)))
        for kind in ('p_d', 'p_f'))
    return SuiteResult(
        'Several targets by dynamic programming (Fu et al. 2022, Section 4.2)',
        shares.COMMON + f'{runs} runs per point (the paper: 1000), {scenes.N_FRAMES} frames. '
        'Test cases of Figure 7: 1, two lines that cross; 2, line 1 and an arc of 20 px radius; '
        '3, all three. The methods are told the number of targets. P_d (Eq. 15): share of the '
        'points of targets within a pixel of a trajectory; P_f (Eq. 16): points of trajectories '
        "that are no target's, over all pixels. Intervals: bootstrap over runs.",
        rows, _quantities(p_d, p_f), {'snrs': SNRS},
        functools.partial(pictures.draw_multi, means=p_d.means(), half_widths=p_d.half_widths(),
                          snrs=SNRS),
        {'false_alarms': functools.partial(
            pictures.draw_false, means=p_f.means(), half_widths=p_f.half_widths(), snrs=SNRS)},
        _details(p_d, p_f))


def _over(part: NDArray, whole: NDArray) -> float:
    """Return a sum over another one, which may be of no false alarm at all."""
    return part.sum() / max(whole.sum(), 1e-12)


def _quantities(p_d: shares.Shares, p_f: shares.Shares) -> list[Quantity]:
    return [
        *p_d.gains_of_order('P_d of {}, mean', np.mean),
        *p_d.of_rings('gain of the ring in P_d, {}, mean', lambda dp, dpr: (dpr - dp).mean(),
                      'paper: well above 0'),
        *(p_f.of([method],
                 f'P_f of {shares.shown(method)} at SNR 3 over that at SNR 1.5, all cases',
                 lambda p: _over(p[..., -1], p[..., 0]), 'paper: below 1', '')
          for method in METHODS),
        *p_f.of_rings('P_f of {0}-DPR over {0}-DP above SNR 1.8',
                      lambda dp, dpr: _over(dpr[..., 2:], dp[..., 2:]), 'paper: below 1', ''),
        *p_f.of_rings('P_f of {0}-DPR over {0}-DP at SNR 1.5',
                      lambda dp, dpr: _over(dpr[..., 0], dp[..., 0]), 'paper: can be above 1', ''),
        p_f.quantity(
            'P_f in case 3 over the mean of cases 1 and 2, all methods',
            lambda p: (sum(p[method][2].sum() for method in METHODS)
                       / max(sum(p[method][:2].sum() / 2 for method in METHODS), 1e-12)),
            'paper: grows with the number of targets', '')]


def _details(p_d: shares.Shares, p_f: shares.Shares) -> str:
    found, false = p_d.means(), p_f.means()
    points = [(str(case), f'{snr:g}', *(
        f'{100 * found[method][case - 1, 0, number]:.0f} / '
        f'{1e6 * false[method][case - 1, 0, number]:.1f}' for method in METHODS))
        for case, (number, snr) in itertools.product(scenes.MULTI_TARGETS, enumerate(SNRS))]
    times = []
    for order, case in itertools.product(shares.ORDERS, scenes.MULTI_TARGETS):
        truth = scenes.ring_multi(case, shares.TIMED_FRAMES)
        frames = scenes.point_frames(np.random.default_rng(0), truth, 3.0)
        times.append((order.upper(), str(case), shares.ms_per_frame(
            functools.partial(several_targets, frames, f'{order}_{form}', scenes.MULTI_V_MAX,
                              len(truth))
            for form in shares.FORMS), _TABLE_2[order][case - 1]))
    return '\n'.join([
        '## Detection probability in per cent / false alarm rate in 1e-6', '',
        *markdown_table(('case', 'SNR', *map(shares.shown, METHODS)), points), '',
        '## Table 2: milliseconds per frame on one thread, all rounds', '',
        *markdown_table(('method', 'case', 'DP/DPR, here', 'DP/DPR, paper (i5-2400, MATLAB)'),
                        times)])


SUITE = Suite(
    'Two and three targets by the six methods of Fu et al. 2022: Figures 9 and 10 and Table '
    '2 (N runs a point, 12 points).', run_ring_multi)
