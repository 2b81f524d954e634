"""Simulated recordings by name.

The noise is white and Gaussian with a standard deviation of 1, targets are stamps of a unit-norm
Gaussian point spread function, so ``snr`` is the amplitude in one frame.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError, suggestion
from track_before_detect.simulation.motions import place_targets
from track_before_detect.simulation.parameters import Scenario
from track_before_detect.simulation.sensor import add_path

SCENARIOS: dict[str, Scenario] = {
    'eo_ir_drones': Scenario(
        'Electro-optical or infrared camera, three dim drones on gently curved courses.',
        n_frames=40, n_targets=3, snr=3.0, snr_spread=1.5, motion='turns',
        speed_px_per_frame=0.9, turn_rate_rad_per_frame=0.025),
    'radar_plots': Scenario(
        'Range-bearing maps of a scanning radar after the matched filter, two targets whose '
        'echo fluctuates from scan to scan.',
        height=96, width=128, n_frames=30, fps=2.0, n_targets=2, snr=4.0,
        fluctuation='rayleigh', speed_px_per_frame=0.8),
    'three_targets': Scenario(
        'Three targets on straight lines, at least 12 px apart.', n_targets=3),
    'single_target': Scenario('One target on a straight line.'),
    'crossing': Scenario(
        'Two targets that cross at right angles in the middle of the recording.', n_targets=2,
        snr=4.0, motion='crossing', speed_px_per_frame=0.8),
    'parallel': Scenario(
        'Two targets side by side.', n_targets=2, snr=4.0, motion='parallel',
        speed_px_per_frame=0.8, separation_px=5.0),
    'maneuver': Scenario(
        'One target on an arc.', n_frames=30, snr=4.0, motion='arc',
        speed_px_per_frame=0.9, radius_px=25.0),
    'range_doppler': Scenario(
        'Range-Doppler maps of a radar, one dwell a second: rows are range bins, columns Doppler '
        'bins, and a target moves by up to 8 range bins a dwell as its Doppler says.',
        height=256, width=64, n_frames=16, fps=1.0, motion='range_doppler',
        speed_px_per_frame=8.0, range_bins_per_doppler_bin=0.3, doppler_drift_bins=0.5),
    'noise': Scenario('Noise alone.', n_targets=0),
}


@dataclass(frozen=True)
class SimulatedRecording:
    """Frames and what is in them.

    Attributes
    ----------
    frames : array of float32, shape (T, H, W)
        Noise of standard deviation 1, and targets.
    stamps : array, shape (T,)
        Seconds, from 0.
    truth : array, shape (N, 4)
        Rows [frame, id, x, y], by id and frame.
    scenario : Scenario
        Parameters it was made with.
    """

    frames: NDArray[np.float32]
    stamps: NDArray[np.float64]
    truth: NDArray[np.float64]
    scenario: Scenario


def simulate(name: str, seed: int, **overrides: Any) -> SimulatedRecording:
    """Make a recording; the same arguments give the same recording.

    Parameters
    ----------
    name : str
        One of :data:`SCENARIOS`.
    seed : int
        Not negative.
    **overrides
        Parameters of :class:`Scenario` to change; the noise does not depend on them as long as
        the frames keep their size.
    """
    scenario = _overridden(name, overrides)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ParameterError(f'seed must be a whole number, not negative, got {seed!r}')
    for_noise, for_motion, for_amplitude = (
        np.random.default_rng(part) for part in np.random.SeedSequence(int(seed)).spawn(3))
    shape = (scenario.n_frames, scenario.height, scenario.width)
    positions = place_targets(name, scenario, for_motion)
    snr = scenario.snr * for_amplitude.uniform(1.0, scenario.snr_spread, len(positions))
    amplitudes = np.repeat(snr[:, None], scenario.n_frames, axis=1)
    if scenario.fluctuation == 'rayleigh':
        amplitudes *= np.sqrt(for_amplitude.exponential(1.0, amplitudes.shape))
    frames = for_noise.standard_normal(shape, np.float32)
    for path, amplitude in zip(positions, amplitudes, strict=True):
        # Columns that go round show a target at both edges.
        turns = (-1, 0, 1) if scenario.doppler_ambiguities else (0,)
        if scenario.doppler_ambiguities:
            path[:, 0] = (path[:, 0] + 0.5) % scenario.width - 0.5
        streaks = None
        if scenario.exposure_s and scenario.n_frames > 1:
            streaks = scenario.exposure_s * scenario.fps * np.gradient(path, axis=0)
        for turn in turns:
            add_path(frames, path + [turn * scenario.width, 0], scenario.psf_sigma_px, amplitude,
                     streaks)
    truth = [np.column_stack([np.arange(len(path)), np.full(len(path), target), path])
             for target, path in enumerate(positions)]
    return SimulatedRecording(
        frames, np.arange(scenario.n_frames) / scenario.fps,
        np.concatenate(truth) if truth else np.zeros((0, 4)), scenario)


def _overridden(name: str, overrides: dict[str, Any]) -> Scenario:
    """Return the scenario of that name with some parameters changed."""
    if name not in SCENARIOS:
        raise ParameterError(f'unknown scenario {name!r}; {suggestion(name, SCENARIOS)}')
    names = [field.name for field in dataclasses.fields(Scenario) if field.metadata]
    for key in overrides:
        if key not in names:
            raise ParameterError(
                f'unknown parameter {key!r} of a scenario; {suggestion(key, names)}')
    return dataclasses.replace(SCENARIOS[name], **overrides)
