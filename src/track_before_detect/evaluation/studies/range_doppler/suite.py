"""Range-Doppler maps: the SNR at which a target is found with the coupling, and without."""

from __future__ import annotations

from collections.abc import Mapping
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.report import Quantity, share, SuiteResult
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.runs import checked_runs, seeds_of
from track_before_detect.evaluation.metrics.confidence import bootstrap_interval
from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import SCENARIOS, simulate
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.types import FrameBatch

SCENE = SCENARIOS['range_doppler']
RATE = 0.05
# Batches of noise per scene, for the rate of false alarms that comes out.
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


def options_for(motion: str, **more: Any) -> DetectorOptions:
    """Return the options of one of the two detectors."""
    return DetectorOptions(psf_sigma_px=SCENE.psf_sigma_px, amplitudes='complex',
                           **MOTIONS[motion], **more)


@functools.cache
def _detector(motion, threshold):
    """Return one of the two detectors; both are kept, with their tables."""
    return ConvexDetector(options_for(motion, threshold=threshold))


def _found(item, maps):
    """Return the positions (T, 2) of all trajectories in complex maps."""
    result = _detector(item['motion'], item['threshold']).detect(FrameBatch.of(maps, _stamps()))
    return [one.positions for one in result.found]


def _stamps():
    return np.arange(SCENE.n_frames) / SCENE.fps


def _noise(generator):
    return noise_frames(generator, (SCENE.n_frames, SCENE.height, SCENE.width), True)


def false_alarm(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return whether a batch of noise yields a trajectory.

    Parameters
    ----------
    item : mapping
        ``motion`` of :data:`MOTIONS`, ``threshold`` and ``seed``.
    """
    return {'alarm': bool(_found(item, _noise(np.random.default_rng(item['seed']))))}


def snr_of_detection(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return the SNR from which on the target of one scene is found, by bisection.

    The noise, the course of the target and the phase of each echo stay the same.

    Parameters
    ----------
    item : mapping
        As of :func:`false_alarm`.
    """
    generator = np.random.default_rng(item['seed'])
    noise = _noise(generator)
    truth = simulate('range_doppler', item['seed']).truth[:, 2:]
    target = np.zeros(noise.shape)
    for picture, (x, y) in zip(target, truth, strict=True):
        add_target(picture, x, y, SCENE.psf_sigma_px, 1.0)
    echo = target * np.exp(2j * np.pi * generator.random(len(noise)))[:, None, None]
    low, high = SNRS
    for _ in range(HALVINGS):
        snr = 0.5 * (low + high)
        found = _found(item, (noise + snr * echo).astype(np.complex64))
        near = len(match_trajectories(found, [truth], FOUND_PX).pairs)
        low, high = (low, snr) if near else (snr, high)
    return {'snr': 0.5 * (low + high)}


def run_range_doppler(runs: int, seed: int, runner: Runner) -> SuiteResult:
    """Compare the motion models over range-Doppler maps; arguments as of every suite."""
    checked_runs(runs, seed)
    noise_seeds = seeds_of(seed, 'noise', NOISE_PER_SCENE * runs)
    scene_seeds = seeds_of(seed, 'scenes', runs)
    thresholds, snrs, quantities = {}, {}, []
    for motion in MOTIONS:
        thresholds[motion] = ConvexDetector(options_for(motion, false_alarm_rate=RATE)).threshold(
            _stamps(), (SCENE.height, SCENE.width), runner.progress)
        same = {'motion': motion, 'threshold': thresholds[motion]}
        alarms = runner.map(false_alarm, [{**same, 'seed': one} for one in noise_seeds],
                            f'searching noise, {motion}')
        quantities.append(share(
            f'noise batches with a trajectory, {motion}',
            sum(result['alarm'] for result in alarms), len(alarms), 'batches',
            f'requested: {100 * RATE:g} %, threshold {thresholds[motion]:.2f}'))
        snrs[motion] = np.array([result['snr'] for result in runner.map(
            snr_of_detection, [{**same, 'seed': one} for one in scene_seeds],
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
        f'{SCENE.speed_px_per_frame:g} range bins a dwell as its Doppler says. The detector '
        'convex with amplitudes complex, once with motion_model range_doppler (coupled) and once '
        'with nearly_constant_velocity and the speed that is needed (uncoupled), all other '
        f'options as by default, each with the threshold it calibrates for {100 * RATE:g} % false '
        f'alarms a batch. For {runs} scenes the SNR (amplitude over noise in one dwell) from '
        'which on a trajectory lies within '
        f'{FOUND_PX:g} bins of the target on average is bisected, noise and phases unchanged. '
        'Intervals: Wilson for shares, else bootstrap; those of the gain take the thresholds as '
        'they are.',
        rows, quantities,
        {'runs': runs, 'seed': seed, 'false_alarm_rate': RATE, 'thresholds': thresholds},
        lambda figure: _draw(figure, snrs))


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
