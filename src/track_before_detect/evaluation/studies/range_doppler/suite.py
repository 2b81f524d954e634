"""Range-Doppler maps: the SNR at which a target is found with the coupling, and without."""

from collections.abc import Mapping
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.pictures import BLUE, RED, tidy
from track_before_detect.evaluation.engine.quantities import estimate, share
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of, seeds_of
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.studies.range_doppler.runs import (
    false_alarm,
    FOUND_PX,
    snr_of_detection,
)
from track_before_detect.simulation.scenarios import Scenario, simulate

RATE = 0.05
# Batches of noise per scene, for the rate of false alarms that comes out.
NOISE_PER_SCENE = 4
GOAL_DB = 1.5
_COLOURS = {'coupled': BLUE, 'uncoupled': RED}


def options_of(scene: Scenario) -> dict[str, dict[str, Any]]:
    """Return the options of both detectors; all else is left to the defaults."""
    same = {'psf_sigma_px': scene.psf_sigma_px, 'amplitudes': 'complex'}
    return {
        'coupled': {**same, 'motion_model': 'range_doppler',
                    'range_bins_per_doppler_bin': scene.range_bins_per_doppler_bin},
        'uncoupled': {**same, 'motion_model': 'nearly_constant_velocity',
                      'max_speed_px_s': scene.speed_px_per_frame * scene.fps}}


def run_range_doppler(runs: int, seed: int, runner: Runner, **overrides: Any) -> SuiteResult:
    """Compare the motion models over range-Doppler maps.

    Parameters
    ----------
    runs, seed, runner, **overrides
        As of :meth:`Suite.run`, and parameters of the scenario to change.
    """
    scene = simulate('range_doppler', 0, **overrides).scenario
    shape = (scene.n_frames, scene.height, scene.width)
    thresholds, snrs, quantities = {}, {}, []
    for motion, wanted in options_of(scene).items():
        thresholds[motion] = runner.threshold({**wanted, 'false_alarm_rate': RATE}, shape)
        same = {'options': {**wanted, 'threshold': thresholds[motion]}, 'shape': shape}
        alarms = runner.map(false_alarm, items_of(seed, 'noise', NOISE_PER_SCENE * runs, **same),
                            f'searching noise, {motion}')
        quantities.append(share(
            f'noise batches with a trajectory, {motion}',
            sum(result['alarm'] for result in alarms), len(alarms), 'batches',
            f'requested: {100 * RATE:g} %, threshold {thresholds[motion]:.2f}'))
        snrs[motion] = np.array([result['snr'] for result in runner.map(
            snr_of_detection, items_of(seed, 'scenes', runs, **same, overrides=overrides),
            f'searching targets, {motion}')])
        quantities.append(estimate(
            f'SNR from which on half of the targets are found, {motion}', snrs[motion],
            _median_db, 'targets', 'dB'))
    both = np.stack([snrs['coupled'], snrs['uncoupled']], axis=1)
    quantities += [
        estimate('gain of the coupling, mean over targets', both, mean_gain, 'targets', 'dB',
                 f'goal: {GOAL_DB:g} dB'),
        estimate('gain of the coupling, at half of the targets found', both, _median_gain,
                 'targets', 'dB')]
    rows = [{'seed': one, **{f'snr_{motion}': float(values[k]) for motion, values in snrs.items()}}
            for k, one in enumerate(seeds_of(seed, 'scenes', runs))]
    return SuiteResult(
        'Range-Doppler maps with and without the coupling',
        f'Maps of {scene.height} range x {scene.width} Doppler bins, {scene.n_frames} dwells, '
        f'PSF of {scene.psf_sigma_px:g} bins, circular complex Gaussian noise; one target of '
        'constant amplitude and random phase in each dwell, that moves by up to '
        f'{scene.speed_px_per_frame:g} range bins a dwell as its Doppler says. The detector '
        'convex with amplitudes complex, once with motion_model range_doppler (coupled) and once '
        'with nearly_constant_velocity and the speed that is needed (uncoupled), all other '
        f'options as by default, each with the threshold it calibrates for {100 * RATE:g} % false '
        f'alarms a batch. For {runs} scenes the SNR (amplitude over noise in one dwell) from '
        'which on a trajectory lies within '
        f'{FOUND_PX:g} bins of the target on average is bisected, noise and phases unchanged. '
        'Intervals: Wilson for shares, else bootstrap; those of the gain take the thresholds as '
        'they are.',
        rows, quantities, {'false_alarm_rate': RATE, 'thresholds': thresholds},
        functools.partial(_draw, snrs=snrs))


def mean_gain(both: NDArray) -> float:
    """Return the mean gain in dB for SNRs (N, 2), coupled and uncoupled."""
    return float(np.mean(20 * np.log10(both[:, 1] / both[:, 0])))


def _median_db(snrs: NDArray) -> float:
    return float(20 * np.log10(np.median(snrs)))


def _median_gain(both: NDArray) -> float:
    return _median_db(both[:, 1]) - _median_db(both[:, 0])


def _draw(figure: Any, snrs: Mapping[str, NDArray]) -> None:
    """Draw the share of targets found over the SNR."""
    axes = figure.subplots()
    for motion, values in snrs.items():
        ordered = np.sort(20 * np.log10(values))
        axes.step(ordered, (1 + np.arange(len(ordered))) / len(ordered), where='post',
                  color=_COLOURS[motion], label=motion)
    axes.set(xlabel='SNR in one dwell [dB]', ylabel='share of targets found', ylim=(0, 1.02))
    axes.legend()
    tidy([axes], grid=False)


SUITE = Suite(
    'Range-Doppler maps in complex noise (N scenes, 4 N batches of noise): the SNR at which a '
    'target is found with the coupling of range and Doppler, and without it.',
    run_range_doppler)
