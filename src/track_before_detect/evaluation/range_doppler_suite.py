"""Range-Doppler maps: the SNR at which a target is found with the coupling, and without."""

from __future__ import annotations

from collections.abc import Mapping
import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.confidence import bootstrap_interval
from track_before_detect.evaluation.report import Quantity, SuiteResult
from track_before_detect.evaluation.runner import Runner
from track_before_detect.evaluation.runs import checked_runs, seeds_of
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import SCENARIOS, simulate
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.convex import ConvexDetector
from track_before_detect.solvers.path_search import PathSearch

SCENE = SCENARIOS['range_doppler']
RATE = 0.05
# Batches of noise per scene, for the threshold.
NOISE_PER_SCENE = 4
# The SNR at which a target is found is bisected between these, to their distance over 2^7.
SNRS = (0.5, 3.0)
HALVINGS = 7
FOUND_PX = 3.0
GOAL_DB = 1.5

# What the detectors differ in; all else is left to the defaults.
MOTIONS: dict[str, dict[str, Any]] = {
    'coupled': {'motion_model': 'range_doppler',
                'range_bins_per_doppler_bin': SCENE.range_bins_per_doppler_bin},
    'uncoupled': {'motion_model': 'nearly_constant_velocity',
                  'max_speed_px_s': SCENE.speed_px_per_frame * SCENE.fps},
}
_COLOURS = {'coupled': '#1f77b4', 'uncoupled': '#d62728'}


class _PowerSearch(PathSearch):
    """Search for the largest sum of |h|^2, the squared statistic of free complex amplitudes."""

    def scores(self, frames: NDArray) -> NDArray:
        """Return |h|^2: h^2 of the real part and of the imaginary part, which do not mix."""
        real, imaginary = (np.ascontiguousarray(part, np.float32)
                           for part in (frames.real, frames.imag))
        return super().scores(real) + super().scores(imaginary)


@functools.cache
def _search(motion):
    """Return the search of one detector, with its tables."""
    detector = ConvexDetector(DetectorOptions(
        psf_sigma_px=SCENE.psf_sigma_px, amplitudes='signed', **MOTIONS[motion]))
    shape = (SCENE.height, SCENE.width)
    graph = detector.graph(np.arange(SCENE.n_frames) / SCENE.fps, shape)
    return _PowerSearch(graph, detector.psf, shape, detector.model)


def complex_noise(generator: np.random.Generator) -> NDArray[np.complex128]:
    """Return maps (T, H, W) of circular Gaussian noise, E|n|^2 = 1."""
    parts = generator.standard_normal((2, SCENE.n_frames, SCENE.height, SCENE.width))
    return math.sqrt(0.5) * (parts[0] + 1j * parts[1])


def largest_in_noise(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return the largest squared statistic in one batch of noise."""
    noise = complex_noise(np.random.default_rng(item['seed']))
    return {'largest': _search(item['motion']).best_value(noise)}


def snr_of_detection(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return the SNR from which on the target of one scene is found, by bisection.

    The noise, the course of the target and the phase of each echo stay the same.
    """
    generator = np.random.default_rng(item['seed'])
    noise = complex_noise(generator)
    truth = simulate('range_doppler', item['seed']).truth[:, 2:]
    target = np.zeros(noise.shape)
    for picture, (x, y) in zip(target, truth, strict=True):
        add_target(picture, x, y, SCENE.psf_sigma_px, 1.0)
    echo = target * np.exp(2j * np.pi * generator.random(len(noise)))[:, None, None]
    search = _search(item['motion'])
    low, high = SNRS
    for _ in range(HALVINGS):
        snr = 0.5 * (low + high)
        _, found = search.best_paths(noise + snr * echo, item['bound'], FOUND_PX,
                                     lambda _: True, 3)
        near = any(np.hypot(*(path.positions - truth).T).mean() < FOUND_PX for path in found)
        low, high = (low, snr) if near else (snr, high)
    return {'snr': 0.5 * (low + high)}


def run_range_doppler(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Compare the motion models over range-Doppler maps; arguments as of every suite."""
    checked_runs(runs, seed)
    noise_seeds = seeds_of(seed, 'noise', max(NOISE_PER_SCENE * runs, 20))
    scene_seeds = seeds_of(seed, 'scenes', runs)
    bounds, snrs, quantities = {}, {}, []
    for motion in MOTIONS:
        maxima = np.array([result['largest'] for result in runner.map(
            largest_in_noise, [{'motion': motion, 'seed': one} for one in noise_seeds],
            f'searching noise, {motion}')])
        bounds[motion] = tail_value(maxima)
        quantities.append(Quantity(
            f'threshold on the squared statistic, {motion}', bounds[motion],
            *bootstrap_interval(maxima, tail_value), len(maxima), 'batches of noise'))
        snrs[motion] = np.array([result['snr'] for result in runner.map(
            snr_of_detection,
            [{'motion': motion, 'seed': one, 'bound': bounds[motion]} for one in scene_seeds],
            f'searching targets, {motion}')])
        quantities.append(Quantity(
            f'SNR from which on half of the targets are found, {motion}',
            _median_db(snrs[motion]), *bootstrap_interval(snrs[motion], _median_db), runs,
            'targets', 'dB'))
    both = np.stack([snrs['coupled'], snrs['uncoupled']], axis=1)
    quantities += [
        Quantity('gain of the coupling, mean over targets', mean_gain(both),
                 *bootstrap_interval(both, mean_gain), runs, 'targets', 'dB',
                 f'goal: {GOAL_DB:g} dB'),
        Quantity('gain of the coupling, at half of the targets found', _median_gain(both),
                 *bootstrap_interval(both, _median_gain), runs, 'targets', 'dB')]
    rows = [{'seed': one, **{f'snr_{motion}': float(snrs[motion][k]) for motion in MOTIONS}}
            for k, one in enumerate(scene_seeds)]
    return SuiteResult(
        'Range-Doppler maps with and without the coupling',
        f'Maps of {SCENE.height} range x {SCENE.width} Doppler bins, {SCENE.n_frames} dwells, '
        f'PSF of {SCENE.psf_sigma_px:g} bins, circular complex Gaussian noise; one target of '
        'constant amplitude and random phase in each dwell, that moves by up to '
        f'{SCENE.speed_px_per_frame:g} range bins a dwell as its Doppler says. The same search '
        'of the largest sum of |h|^2 over the paths of motion_model range_doppler (coupled) and '
        'of nearly_constant_velocity with the speed that is needed (uncoupled), all other '
        f'options as by default, each at {100 * RATE:g} % false alarms by a Gumbel fit to '
        f'batches of noise. For {runs} scenes the SNR (amplitude over noise in one dwell) from '
        'which on the best path passes the threshold and lies within '
        f'{FOUND_PX:g} bins of the target is bisected, noise and phases unchanged. Intervals: '
        'bootstrap; those of the gain take the thresholds as they are.',
        rows, quantities, {'runs': runs, 'seed': seed, 'false_alarm_rate': RATE},
        lambda figure: _draw(figure, snrs))


def tail_value(maxima: NDArray) -> float:
    """Return what the largest value in noise passes at the rate, by a Gumbel distribution."""
    scale = float(np.std(maxima)) * math.sqrt(6) / math.pi
    return float(np.mean(maxima)) - scale * (np.euler_gamma + math.log(-math.log1p(-RATE)))


def mean_gain(both: NDArray) -> float:
    """Return the mean gain in dB for SNRs (N, 2), coupled and uncoupled."""
    return float(np.mean(20 * np.log10(both[:, 1] / both[:, 0])))


def _median_db(snrs):
    return float(20 * np.log10(np.median(snrs)))


def _median_gain(both):
    return _median_db(both[:, 1]) - _median_db(both[:, 0])


def _draw(figure, snrs):
    """Draw the share of targets found over the SNR."""
    axes = figure.subplots()
    for motion, values in snrs.items():
        ordered = np.sort(20 * np.log10(values))
        axes.step(ordered, (1 + np.arange(len(ordered))) / len(ordered), where='post',
                  color=_COLOURS[motion], label=motion)
    axes.set_xlabel('SNR in one dwell [dB]')
    axes.set_ylabel('share of targets found')
    axes.set_ylim(0, 1.02)
    axes.legend()
    axes.spines[['top', 'right']].set_visible(False)
