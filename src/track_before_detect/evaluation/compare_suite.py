"""Every detector on the same scenes, at equal false alarms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation import compare_runs
from track_before_detect.evaluation.compare_runs import SCENES
from track_before_detect.evaluation.confidence import bootstrap_interval
from track_before_detect.evaluation.report import markdown_table, Quantity, share, SuiteResult
from track_before_detect.evaluation.runner import Runner
from track_before_detect.evaluation.runs import checked_runs, seeds_of
from track_before_detect.options import DetectorOptions, DETECTORS
from track_before_detect.tracking.pipeline import DETECTOR_CLASSES

SNRS = (1.5, 2.0, 3.0)
RATE = 0.05
OURS = 'convex'
# The convex detector without what is known of the targets.
VARIANTS = {
    'convex, fluctuating': {'detector': OURS, 'amplitude_model': 'fluctuating'},
    'convex, partial': {'detector': OURS, 'amplitude_model': 'fluctuating',
                        'presence': 'partial'},
}
NOISES = ('noise', 'noise six')
# Points by which the convex detector may be behind.
MARGIN = 0.02


def run_compare(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Search all scenes by all detectors; arguments as of every suite."""
    checked_runs(runs, seed)
    wanted, refused = _methods()
    by_noise = {noise: _with_thresholds(wanted, noise, runner) for noise in NOISES}

    def items_of(scene, snr, count):
        methods = by_noise[NOISES[compare_runs.shape_of(scene) == compare_runs.SIX]]
        return [{'scene': scene, 'snr': snr, 'methods': methods, 'seed': one}
                for one in seeds_of(seed, f'compare {scene} {snr:g}', count)]

    items = [item for scene in SCENES for snr in SNRS for item in items_of(scene, snr, runs)]
    results = runner.map(compare_runs.search, items, 'searching scenes')
    noise_items = [item for noise in NOISES for item in items_of(noise, 0.0, 2 * runs)]
    noise = runner.map(compare_runs.search, noise_items, 'searching noise')
    names = list(wanted)

    def gathered(key):
        return np.array([[result[name][key] for name in names] for result in results],
                        float).reshape(len(SCENES), len(SNRS), runs, len(names))

    targets = np.array([compare_runs.n_targets(scene) for scene in SCENES])
    found = gathered('found') / targets[:, None, None, None]
    alarms = np.array([[result[name]['false'] for name in names] for result in noise]).reshape(
        len(NOISES), 2 * runs, len(names))
    rows = [{'scene': item['scene'], 'snr': item['snr'], 'seed': item['seed'], 'method': name,
             **result[name]}
            for item, result in zip(items + noise_items, results + noise, strict=True)
            for name in names]
    leaders = _leaders(found, names)
    return SuiteResult(
        'Every detector on the same scenes',
        f'{runs} batches per scene and SNR: 20 frames of 96 x 96 pixels (the six targets of Guo '
        'et al. 2018, Section 4.2: 6 frames of 50 x 50), PSF of 1 px, targets of constant '
        'amplitude, which every method is told; "convex, fluctuating" is the convex detector '
        'without that knowledge, "convex, partial" also without that of targets being there in '
        'all frames. Lines and arcs (20 px radius) at 0.2 to 1 px/frame, two parallel '
        'targets 5 px apart, two that cross at right angles, the three of Fu et al. 2022, Figure '
        f'7, frames 20 to 39, and a line that is there in the last or first '
        f'{compare_runs.PRESENT} frames. Thresholds for {100 * RATE:g} % of noise batches with a '
        'trajectory, each calibrated by its own method. A target is found by a trajectory less '
        f'than {compare_runs.FOUND_PX:g} px from it on average that is there in at least half of '
        'its frames; each counts once. Intervals: bootstrap over batches, which all methods '
        'saw; Wilson for noise.' + (f' Not compared: {"; ".join(refused)}.' if refused else ''),
        rows, _quantities(found, names, leaders, alarms),
        {'runs': runs, 'seed': seed, 'snrs': SNRS, 'methods': by_noise},
        lambda figure: _draw(figure, found.mean(axis=2), names),
        {'scenes': _draw_scenes},
        _details(found, gathered('gospa'), gathered('false'), names, leaders))


def _methods():
    """Return the options of each method, and what is not compared and why."""
    wanted: dict[str, dict[str, str]] = {}
    refused = []
    for name in DETECTORS:
        options = {'detector': name, 'amplitude_model': 'constant'}
        try:
            DETECTOR_CLASSES[name](DetectorOptions.from_mapping(options))
        except ParameterError as error:
            refused.append(f'{name} ({error})')
            continue
        wanted[name] = options
        if name == OURS:
            wanted.update(VARIANTS)
    return wanted, refused


def _with_thresholds(wanted, noise, runner):
    """Return options with the threshold for batches of the size of a scene of noise."""
    n_frames, height, width = compare_runs.shape_of(noise)
    made = {}
    for name, options in wanted.items():
        detector = DETECTOR_CLASSES[options['detector']](
            DetectorOptions.from_mapping({**options, 'false_alarm_rate': RATE}))
        made[name] = {**options, 'threshold': detector.threshold(
            np.arange(float(n_frames)), (height, width), runner.progress)}
    return made


def _leaders(found, names) -> NDArray[np.int64]:
    """Return which method finds most by scene and SNR, of equal ones ours."""
    means = found.mean(axis=2)
    ours = np.array([name == OURS for name in names])
    return np.argmax(means + 1e-9 * ours, axis=2)


def _quantities(found, names, leaders, alarms):
    quantities = []
    ours = names.index(OURS)
    others = [number for number, name in enumerate(names) if name not in (OURS, *VARIANTS)]
    for scene, label in enumerate(SCENES):
        for point, snr in enumerate(SNRS):
            by_run = found[scene, point]
            rival = others[int(np.argmax(by_run.mean(axis=0)[others]))]
            leader = leaders[scene, point]
            quantities.append(Quantity(
                f'{label}, SNR {snr:g}: best method', float(by_run[:, leader].mean()),
                *bootstrap_interval(by_run[:, leader], lambda drawn: float(drawn.mean())),
                len(by_run), 'batches', '%', '; '.join(_equal_to(leader, by_run, names))))
            gain = by_run[:, ours] - by_run[:, rival]
            low, high = bootstrap_interval(gain, lambda drawn: float(drawn.mean()))
            quantities.append(Quantity(
                f'{label}, SNR {snr:g}: convex minus the best other', float(gain.mean()), low,
                high, len(by_run), 'batches', '%',
                f'best other: {names[rival]}; {_verdict(gain.mean(), low, high)}'))
    for number, noise in enumerate(NOISES):
        shape = ' x '.join(map(str, compare_runs.shape_of(noise)))
        for method, name in enumerate(names):
            hit = alarms[number, :, method] > 0
            quantities.append(share(f'noise of {shape} with a trajectory: {name}',
                                    int(hit.sum()), len(hit), 'batches',
                                    f'requested: {100 * RATE:g} %'))
    return quantities


def _equal_to(leader, by_run, names):
    """Return the best method, and those that find no less."""
    means = by_run.mean(axis=0)
    return [names[leader], *(name for number, name in enumerate(names)
                             if number != leader and means[number] >= means[leader])]


def _verdict(gain, low, high):
    """Say how the convex detector stands to the best other."""
    if gain >= 0:
        return 'convex is best'
    if gain >= -MARGIN:
        return 'convex is within 2 points'
    return 'convex is behind' if high < 0 else 'convex is behind, within chance'


def _details(found, gospa, false, names, leaders):
    lines = []
    for title, values, factor, digits in (
            ('Targets found in per cent; the best in bold', found, 100, 0),
            (f'GOSPA in pixels per batch (order 2, cutoff {compare_runs.CUTOFF_PX:g} px, change '
             f'of identity {compare_runs.SWITCH_PX:g} px), mean', gospa, 1, 1),
            ('False trajectories per batch with targets', false, 1, 2)):
        means = factor * values.mean(axis=2)
        rows = []
        for scene, label in enumerate(SCENES):
            for point, snr in enumerate(SNRS):
                cells = [f'{value:.{digits}f}' for value in means[scene, point]]
                if values is found:
                    leader = leaders[scene, point]
                    cells[leader] = f'**{cells[leader]}**'
                rows.append((label, f'{snr:g}', *cells))
        lines += [f'## {title}', '', *markdown_table(('scene', 'SNR', *names), rows), '']
    return '\n'.join(lines).rstrip()


def _draw(figure, means, names):
    """Draw the share of targets found as a table in colours."""
    figure.set_size_inches(11, 9)
    axes = figure.subplots()
    table = 100 * means.reshape(-1, len(names))
    image = axes.imshow(table, vmin=0, vmax=100, cmap='viridis', aspect='auto')
    for row, values in enumerate(table):
        for column, value in enumerate(values):
            axes.text(column, row, f'{value:.0f}', ha='center', va='center', fontsize='small',
                      color='black' if value > 60 else 'white',
                      fontweight='bold' if value >= values.max() else 'normal')
    axes.set_xticks(np.arange(len(names)), names, rotation=35, ha='left')
    axes.xaxis.tick_top()
    labels = [f'{scene}, SNR {snr:g}' for scene in SCENES for snr in SNRS]
    axes.set_yticks(np.arange(len(labels)), labels)
    for edge in np.arange(len(SNRS), len(labels), len(SNRS)):
        axes.axhline(edge - 0.5, color='white', linewidth=2)
    axes.tick_params(length=0)
    figure.colorbar(image, label=f'targets found at {100 * RATE:g} % false alarms [%]', shrink=0.6)


def _draw_scenes(figure):
    """Draw one example of each scene, from the first frame (dark) to the last."""
    figure.set_size_inches(11, 5.8)
    for number, (axes, (label, make)) in enumerate(
            zip(figure.subplots(2, 4).ravel(), SCENES.items(), strict=True)):
        paths = make(np.random.default_rng(number))
        low, high = np.nanmin(paths, axis=(0, 1)), np.nanmax(paths, axis=(0, 1))
        half = 0.5 * (high - low).max() + 4
        for path in paths:
            axes.scatter(*path.T, c=np.arange(len(path)), s=14, cmap='plasma')
        for limits, middle in ((axes.set_xlim, 0.5 * (low + high)[0]),
                               (axes.set_ylim, 0.5 * (low + high)[1])):
            limits(middle - half, middle + half)
        axes.invert_yaxis()
        axes.set_aspect('equal')
        axes.set_title(label, fontsize='medium')
        axes.grid(alpha=0.25)
