"""Single runs of the suite ``range-doppler``."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.detectors import search
from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.simulation.sensor import add_path
from track_before_detect.solvers.calibration.noise_study import noise_frames

# The SNR at which a target is found is bisected between these, to their distance over 2^7.
SNRS = (0.5, 3.0)
HALVINGS = 7
FOUND_PX = 3.0


def false_alarm(item: Mapping[str, Any]) -> dict[str, bool]:
    """Return whether a batch of noise yields a trajectory.

    Parameters
    ----------
    item : mapping
        ``options`` of the detector with its threshold, ``shape`` of the maps and ``seed``.
    """
    maps = noise_maps(np.random.default_rng(item['seed']), item['shape'])
    return {'alarm': bool(search(item['options'], maps).found)}


def snr_of_detection(item: Mapping[str, Any]) -> dict[str, float]:
    """Return the SNR from which on the target of one scene is found, by bisection.

    The noise, the course of the target and the phase of each echo stay the same.

    Parameters
    ----------
    item : mapping
        As of :func:`false_alarm`, and ``overrides`` of the scenario.
    """
    generator = np.random.default_rng(item['seed'])
    noise = noise_maps(generator, item['shape'])
    made = simulate('range_doppler', item['seed'], **item['overrides'])
    truth = made.truth[:, 2:]
    target = np.zeros(noise.shape)
    add_path(target, truth, made.scenario.psf_sigma_px, 1.0)
    echo = target * np.exp(2j * np.pi * generator.random(len(noise)))[:, None, None]
    low, high = SNRS
    for _ in range(HALVINGS):
        snr = 0.5 * (low + high)
        maps = (noise + snr * echo).astype(np.complex64)
        found = [one.positions for one in search(item['options'], maps).found]
        near = len(match_trajectories(found, [truth], FOUND_PX).pairs)
        low, high = (low, snr) if near else (snr, high)
    return {'snr': 0.5 * (low + high)}


def noise_maps(generator: np.random.Generator, shape: tuple[int, int, int]) -> NDArray:
    """Return maps of circular complex noise with E|n|^2 = 1."""
    return noise_frames(generator, tuple(shape), True)
