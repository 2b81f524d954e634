"""Single targets by the six methods of Fu et al. 2022: Figure 6 and Table 1."""

import functools
import itertools

import numpy as np

from track_before_detect.evaluation.benchmarks.dp import PAPER_MS
from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.engine.tables import markdown_table
from track_before_detect.evaluation.studies.ring import pictures, readings, shares
from track_before_detect.evaluation.studies.ring import runs as ring_runs
from track_before_detect.evaluation.studies.ring.scenes import SIDE_PX, SINGLE_V_MAX
from track_before_detect.models.motion.velocity_candidates import straight_lines, whole_velocities
from track_before_detect.solvers.ring.merit_functions import merit_functions, METHODS

SNRS = (1.5, 1.65, 1.8, 2.0, 2.5, 3.0)
LENGTHS = (20, 50, 100)
# Best P_d of the plain forms at SNR 1.5 (Section 4.1).
_STATED = {'cfo': readings.STATED, 'cso': 0.3, 'mff': 0.45}


def run_ring_single(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Detect single targets by all six methods."""
    cells = list(itertools.product(SINGLE_V_MAX, LENGTHS, SNRS))
    items = [item for case, n_frames, snr in cells for item in items_of(
        seed, f'ring-single {case} {n_frames} {snr:g}', runs, case=case, n_frames=n_frames,
        snr=snr)]
    results = runner.map(ring_runs.single, items, 'single targets')
    at = (readings.CASE, readings.N_FRAMES, readings.SNR)
    read = runner.map(
        readings.measure,
        [item for item in items if (item['case'], item['n_frames'], item['snr']) == at],
        'readings of the first order')
    rows = [{**item, **{method: result[method] / item['n_frames'] for method in METHODS}}
            for item, result in zip(items, results, strict=True)]
    table = shares.Shares(np.array([[row[method] for method in METHODS] for row in rows]).reshape(
        len(SINGLE_V_MAX), len(LENGTHS), len(SNRS), runs, len(METHODS)))
    return SuiteResult(
        'Single targets by dynamic programming (Fu et al. 2022, Section 4.1)',
        shares.COMMON + f'{runs} runs per point (the paper: 1000). Test cases of Figure 5: 1, a '
        'line at (1.2, 1.1) px/frame with v_max = 2; 2, a line at (0.6, 0.8); 3, an arc of '
        '20 px diameter at 1 px/frame, both with v_max = 1. P_d (Eq. 15) is the share of frames '
        'in which the largest merit function is within a pixel of the target on both axes. '
        '"Best" is the best of all cases and sequence lengths. Intervals: bootstrap '
        'over runs, in which the methods saw the same frames.',
        rows, _quantities(table), {'snrs': SNRS, 'lengths': LENGTHS},
        functools.partial(pictures.draw_single, means=table.means(),
                          half_widths=table.half_widths(), snrs=SNRS, lengths=LENGTHS,
                          stated=_STATED),
        details='\n\n'.join([_details(table), readings.section(read, {
            shares.shown(method): float(table.means()[method].ravel()[cells.index(at)])
            for method in ('cso_dp', 'mff_dp')})]))


def _quantities(table: shares.Shares) -> list[Quantity]:
    below = np.flatnonzero(np.array(SNRS) < 2)
    above = np.flatnonzero(np.array(SNRS) > 2)
    at_18 = SNRS.index(1.8)
    return [
        *(table.of([f'{order}_dp'], f'best P_d of {order.upper()}-DP at SNR 1.5',
                   lambda p: p[..., 0].max(), f'paper: about {100 * _STATED[order]:g} %')
          for order in shares.ORDERS),
        *table.gains_of_order('{}, mean below SNR 2', lambda gain: gain[..., below].mean()),
        *table.of_rings('largest gain of the ring at SNR 1.8, {}',
                        lambda dp, dpr: (dpr - dp)[..., at_18].max(),
                        'paper: up to 40 points, over all methods'),
        table.quantity('largest gain of the ring anywhere',
                       lambda p: max((p[f'{order}_dpr'] - p[f'{order}_dp']).max()
                                     for order in shares.ORDERS), 'paper: up to 40 points'),
        table.of(['mff_dpr'], 'MFF-DPR at SNR 1.5 with v_max = 2, best length',
                 lambda p: p[0, :, 0].max(), 'paper: less than 40 %'),
        *(table.of([f'cso_{form}', f'mff_{form}'],
                   f'CSO-{form.upper()} minus MFF-{form.upper()} above SNR 2, case 1, N = 20',
                   lambda cso, mff: (cso - mff)[0, 0, above].max(), note)
          for form, note in (('dp', 'paper: above 0'), ('dpr', 'paper: can be above 0'))),
        table.of(['mff_dpr'], 'MFF-DPR on the line (case 2) minus the arc (case 3), mean below '
                 'SNR 2', lambda p: (p[1] - p[2])[:, below].mean(), 'paper: above 0'),
        table.of(['mff_dpr'], 'MFF-DPR with v_max 1 (case 2) minus 2 (case 1), mean below SNR 2',
                 lambda p: (p[1] - p[0])[:, below].mean(), 'paper: above 0')]


def _details(table: shares.Shares) -> str:
    means = table.means()
    lines = ['## Detection probability in per cent', '']
    for case in SINGLE_V_MAX:
        lines += [f'Test case {case}:', '', *markdown_table(
            ('N', 'SNR', *map(shares.shown, METHODS)),
            [(str(n_frames), f'{snr:g}', *(
                f'{100 * means[method][case - 1, length, number]:.0f}' for method in METHODS))
             for (length, n_frames), (number, snr) in itertools.product(
                 enumerate(LENGTHS), enumerate(SNRS))]), '']
    rows = []
    frames = np.random.default_rng(0).standard_normal(
        (shares.TIMED_FRAMES, SIDE_PX, SIDE_PX)).astype(np.float32)
    for v_max, order in itertools.product((1, 2), shares.ORDERS):
        candidates = len(whole_velocities(v_max) if order == 'cfo' else straight_lines(v_max))
        rows.append((order.upper(), str(v_max), str(candidates), shares.ms_per_frame(
            functools.partial(merit_functions, frames, f'{order}_{form}', v_max)
            for form in shares.FORMS), '/'.join(map(str, PAPER_MS[order, v_max]))))
    return '\n'.join([
        *lines, '## Table 1: candidates of a step, and milliseconds per frame on one thread', '',
        *markdown_table(('method', 'v_max', 'candidates', 'DP/DPR, here',
                         'DP/DPR, paper (i5-2400, MATLAB)'), rows)])


SUITE = Suite(
    'Single targets by the six methods of Fu et al. 2022: Figure 6 and Table 1 (N runs a '
    'point, 54 points).', run_ring_single)
