"""Every detector on the same scenes, at equal false alarms."""

from collections.abc import Callable, Mapping, Sequence
import functools
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import named, ParameterError
from track_before_detect.evaluation.engine.detectors import detector_of
from track_before_detect.evaluation.engine.quantities import mean, mean_of, Quantity, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.engine.tables import markdown_table
from track_before_detect.evaluation.metrics.confidence import bootstrap_interval
from track_before_detect.evaluation.metrics.roc import Roc, roc
from track_before_detect.evaluation.studies.compare import pictures, scenes
from track_before_detect.evaluation.studies.compare import runs as compare_runs
from track_before_detect.evaluation.studies.compare.details import reasons, roc_table, Standing
from track_before_detect.evaluation.studies.compare.runs import CUTOFF_PX, FOUND_PX, SWITCH_PX
from track_before_detect.options import DETECTORS
from track_before_detect.runs.runner import Item, Measure

SNRS = (1.5, 2.0, 3.0)
RATE = 0.05
OURS = 'convex'
STRAIGHT, FLUCTUATING, PARTIAL = 'convex-straight', 'convex-fluctuating', 'convex-partial'
UNTOLD = 'convex-untold'
# Points by which the one that is told nothing may be behind the best of all.
UNTOLD_MARGIN = 3
# The convex detector told more or less of the targets.
VARIANTS = {
    STRAIGHT: {'detector': OURS, 'amplitude_model': 'constant',
               'motion_model': 'constant_velocity'},
    FLUCTUATING: {'detector': OURS, 'amplitude_model': 'fluctuating'},
    PARTIAL: {'detector': OURS, 'amplitude_model': 'constant', 'presence': 'partial'},
    UNTOLD: {'detector': OURS, 'amplitude_model': 'either', 'presence': 'partial'},
}
# Scenes whose question is when a target is there: ours is told that it may enter and leave.
PARTIAL_SCENES = ('enters', 'leaves')
# Where the threshold is varied, and the false alarm rate that trajectories are taken down to.
ROC_SCENE, ROC_SNR, ROC_RATE = 'line', 1.5, 0.5
NOISES = ('noise', 'noise six')
# Whose largest speed is one in any direction; that of the others is a number of pixels along
# either axis, which is one in all scenes.
ROUND = ('convex', 'greedy', 'velocity_filter')

Methods = Mapping[str, Mapping[str, Any]]


def run_compare(runs: int, seed: int, runner: Runner, *,
                methods: Methods | None = None) -> SuiteResult:
    """Search all scenes by all detectors.

    Parameters
    ----------
    runs, seed, runner
        As of :meth:`~track_before_detect.evaluation.engine.suite.Suite.run`.
    methods : mapping, optional
        Options of the detector by the name of the method; all unless given.
    """
    known, refused = _methods()
    wanted = known if methods is None else methods
    names = list(wanted)
    by_noise = {noise: _of_size(wanted, noise, RATE, runner) for noise in NOISES}

    def items(scene: str, snr: float, count: int) -> list[dict[str, Any]]:
        return items_of(seed, f'compare {scene} {snr:g}', count, scene=scene, snr=snr,
                        methods=by_noise[NOISES[scenes.shape_of(scene) == scenes.SIX]])

    scene_items = [item for scene in scenes.SCENES for snr in SNRS
                   for item in items(scene, snr, runs)]
    noise_items = [item for noise in NOISES for item in items(noise, 0.0, 2 * runs)]
    results = _each_alone(compare_runs.search, scene_items, 'searching scenes', runner)
    noise = _each_alone(compare_runs.search, noise_items, 'searching noise', runner)
    curves = _rocs(wanted, runs, seed, runner)

    def gathered(key: str) -> NDArray[np.float64]:
        """Return a result by scene, SNR, run and method."""
        return np.array([[result[name][key] for name in names] for result in results],
                        float).reshape(len(scenes.SCENES), len(SNRS), runs, len(names))

    targets = np.array([scenes.n_targets(scene) for scene in scenes.SCENES])[:, None, None]
    found = gathered('found') / targets[..., None]
    alarms = np.array([[result[name]['false'] for name in names] for result in noise]).reshape(
        len(NOISES), 2 * runs, len(names))
    rows = [{'scene': item['scene'], 'snr': item['snr'], 'seed': item['seed'], 'method': name,
             **result[name]}
            for item, result in zip(scene_items + noise_items, results + noise,
                                    strict=True)
            for name in names]
    leaders = _leaders(found, names)
    standings = _standings(found, names)
    return SuiteResult(
        f'{"Every detector" if methods is None else "Some detectors"} on the same scenes',
        f'{runs} batches per scene and SNR: 20 frames of 96 x 96 pixels (the six targets of Guo '
        'et al. 2018, Section 4.2: 6 frames of 50 x 50), PSF of 1 px, targets of constant '
        'amplitude, which every method is told that makes use of it; '
        f'"{FLUCTUATING}" is the convex detector without that knowledge, "{PARTIAL}" without that '
        f'of targets being there in all frames, and "{STRAIGHT}" is told, as velocity_filter is, '
        f'that they move on straight lines; "{UNTOLD}" is told nothing of all this. '
        'All know how fast targets may be: one pixel a frame along either axis, or, where a '
        'method searches a largest speed in any direction, this speed (1 px/frame, those of Guo '
        f'et al. {scenes.SIX_SPEED_PX:.2f}). '
        f'In the scenes {" and ".join(PARTIAL_SCENES)} ours is '
        f'"{PARTIAL}", in all others "{OURS}". '
        'Lines and arcs (20 px radius) at 0.2 to 1 px/frame, two parallel targets 5 px apart, '
        'two that cross at right angles, the three of Fu et al. 2022, Figure 7, '
        f'frames 20 to 39, and a line that is there in the last or first '
        f'{scenes.PRESENT} frames. Thresholds for {100 * RATE:g} % of noise batches with a '
        'trajectory, each calibrated by its own method. A target is found by a trajectory less '
        f'than {FOUND_PX:g} px from it on average that is there in at least half of '
        'its frames; each counts once. Intervals: bootstrap over batches, which all methods '
        'saw; Wilson for noise.' + (f' Not compared: {"; ".join(refused)}.' if refused else '')
        + ('' if methods is None else f' Compared here: {"; ".join(names)}.'),
        rows, _quantities(found, names, leaders, standings, alarms),
        {'snrs': SNRS, 'methods': by_noise},
        functools.partial(pictures.draw_found, means=found.mean(axis=2), snrs=SNRS, names=names,
                          rate=RATE),
        {'scenes': pictures.draw_scenes,
         'roc': functools.partial(pictures.draw_roc, curves=curves, rate=RATE, ours=OURS)},
        '\n\n'.join([
            # They are read off the variants of ours.
            *([reasons(list(standings.values()))] if {OURS, *VARIANTS} <= set(names) else []),
            _details(gathered, found, targets, names, leaders),
            roc_table(curves, f'{ROC_SCENE}, SNR {ROC_SNR:g}, as the threshold varies')]))


def _rocs(wanted: Methods, runs: int, seed: int, runner: Runner) -> dict[str, Roc]:
    """Return the curve of each method in one scene, whose trajectories may be weak."""
    methods = _of_size(wanted, NOISES[0], ROC_RATE, runner)

    def searched(scene: str, snr: float, count: int) -> list[dict[str, Any]]:
        return _each_alone(compare_runs.statistics, items_of(
            seed, f'roc {scene} {snr:g}', count, scene=scene, snr=snr, methods=methods),
            'varying the threshold', runner)

    of_targets, of_noise = searched(ROC_SCENE, ROC_SNR, runs), searched(NOISES[0], 0.0, 2 * runs)
    return {name: roc([max(one[name]['right'], default=np.nan) for one in of_targets],
                      [one[name]['false'] for one in of_noise]) for name in methods}


def _each_alone(measure: Measure, items: Sequence[Item], label: str,
                runner: Runner) -> list[dict[str, Any]]:
    """Return results by method, each of a run of its own: what is kept serves other choices."""
    single = [{**item, 'methods': {name: options}}
              for item in items for name, options in item['methods'].items()]
    results = iter(runner.map(measure, single, label))
    return [{name: next(results)[name] for name in item['methods']} for item in items]


def chosen(names: Sequence[str]) -> Methods:
    """Return the options of some methods by their names."""
    known, _ = _methods()
    return {name: named('method', name, known) for name in names}


def _methods() -> tuple[dict[str, dict[str, str]], list[str]]:
    """Return the options of each method, and what is not compared and why."""
    wanted: dict[str, dict[str, str]] = {}
    refused = []
    for name in DETECTORS:
        options = {'detector': name, 'amplitude_model': 'constant'}
        try:
            detector_of(options)
        except ParameterError as error:
            refused.append(f'{name} ({error})')
            continue
        wanted[name] = options
        if name == OURS:
            wanted.update(VARIANTS)
    return wanted, refused


def _of_size(wanted: Methods, noise: str, rate: float,
             runner: Runner) -> dict[str, dict[str, Any]]:
    """Return options with largest speed and threshold for scenes of the size of one of noise."""
    speed, shape = scenes.largest_speed_px(noise), scenes.shape_of(noise)
    told = {name: {**options, 'max_speed_px_s': speed} if options['detector'] in ROUND
            else dict(options) for name, options in wanted.items()}
    return {name: {**options, 'threshold': runner.threshold(
        {**options, 'false_alarm_rate': rate}, shape)} for name, options in told.items()}


def ours_in(scene: str) -> str:
    """Return the name under which the convex detector stands in a scene."""
    return PARTIAL if scene in PARTIAL_SCENES else OURS


def _leaders(found: NDArray, names: Sequence[str]) -> NDArray[np.int64]:
    """Return which method finds most by scene and SNR, of equal ones ours."""
    means = found.mean(axis=2)
    for number, scene in enumerate(scenes.SCENES):
        if ours_in(scene) in names:
            means[number, :, names.index(ours_in(scene))] += 1e-9
    return np.argmax(means, axis=2)


def _standings(found: NDArray, names: Sequence[str]) -> dict[tuple[str, float], Standing]:
    """Compare ours with the best other method, by scene and SNR, where both were searched by."""
    others = [number for number, name in enumerate(names) if name not in (OURS, *VARIANTS)]
    standings = {}
    for (scene, label), (point, snr) in itertools.product(
            enumerate(scenes.SCENES), enumerate(SNRS)):
        if not others or ours_in(label) not in names:
            continue
        by_run = found[scene, point]
        means = by_run.mean(axis=0)
        rival = others[int(np.argmax(means[others]))]
        gain = by_run[:, names.index(ours_in(label))] - by_run[:, rival]
        standings[label, snr] = Standing(
            label, snr, ours_in(label), names[rival], float(gain.mean()),
            *bootstrap_interval(gain, mean_of), dict(zip(names, means.tolist(), strict=True)))
    return standings


def _quantities(found: NDArray, names: Sequence[str], leaders: NDArray,
                standings: Mapping[tuple[str, float], Standing],
                alarms: NDArray) -> list[Quantity]:
    quantities = []
    for (scene, label), (point, snr) in itertools.product(
            enumerate(scenes.SCENES), enumerate(SNRS)):
        by_run, leader = found[scene, point], leaders[scene, point]
        at = f'{label}, SNR {snr:g}'
        quantities.append(mean(f'{at}: best method', by_run[:, leader], 'batches', '%',
                               '; '.join(_equal_to(leader, by_run, names))))
        if standing := standings.get((label, snr)):
            quantities.append(Quantity(
                f'{at}: {standing.ours} minus the best other', standing.gain, standing.low,
                standing.high, len(by_run), 'batches', '%',
                f'best other: {standing.rival}; {standing.verdict}'))
        if UNTOLD in names:
            quantities.append(mean(
                f'{at}: {UNTOLD} minus the best',
                by_run[:, names.index(UNTOLD)] - by_run[:, leader],
                'batches', '%', f'goal: at least -{UNTOLD_MARGIN} %'))
    for number, noise in enumerate(NOISES):
        shape = ' x '.join(map(str, scenes.shape_of(noise)))
        for method, name in enumerate(names):
            hit = alarms[number, :, method] > 0
            quantities.append(share(f'noise of {shape} with a trajectory: {name}',
                                    int(hit.sum()), len(hit), 'batches',
                                    f'requested: {100 * RATE:g} %'))
    return quantities


def _equal_to(leader: int, by_run: NDArray, names: Sequence[str]) -> list[str]:
    """Return the best method, and those that find no less."""
    means = by_run.mean(axis=0)
    return [names[leader], *(name for number, name in enumerate(names)
                             if number != leader and means[number] >= means[leader])]


def _details(gathered: Callable[[str], NDArray], found: NDArray, targets: NDArray,
             names: Sequence[str], leaders: NDArray) -> str:
    false = gathered('false').mean(axis=2)
    n_tracks = (gathered('found') + gathered('false')).mean(axis=2)
    purity = np.divide(gathered('purity').mean(axis=2), n_tracks,
                       out=np.full(n_tracks.shape, np.nan), where=n_tracks > 0)
    lines: list[str] = []
    for title, means, digits in (
            ('Targets found in per cent; the best in bold', 100 * found.mean(axis=2), 0),
            (f'GOSPA in pixels per batch (order 2, cutoff {CUTOFF_PX:g} px, change '
             f'of identity {SWITCH_PX:g} px), mean',
             gathered('gospa').mean(axis=2), 1),
            ('False trajectories per batch with targets', false, 2),
            (f'Completeness of targets in per cent: frames within {FOUND_PX:g} px of '
             'the one trajectory that has most of them',
             100 * gathered('completeness').mean(axis=2) / targets, 0),
            ('Purity of trajectories in per cent: frames near the one target that has most of '
             'them', 100 * purity, 0)):
        rows = []
        for scene, label in enumerate(scenes.SCENES):
            for point, snr in enumerate(SNRS):
                cells = ['-' if np.isnan(value) else f'{value:.{digits}f}'
                         for value in means[scene, point]]
                if not lines:
                    leader = leaders[scene, point]
                    cells[leader] = f'**{cells[leader]}**'
                rows.append((label, f'{snr:g}', *cells))
        lines += [f'## {title}', '', *markdown_table(('scene', 'SNR', *names), rows), '']
    return '\n'.join(lines).rstrip()


SUITE = Suite(
    'Every detector on eight scenes at SNR 1.5 to 3 (N batches each) at equal false alarms: '
    'the best per scene, targets found, false trajectories, GOSPA.', run_compare, methods=chosen)
