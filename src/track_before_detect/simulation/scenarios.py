"""Simulated recordings by name.

The noise is white and Gaussian with a standard deviation of 1, targets are stamps of a unit-norm
Gaussian point spread function, so ``snr`` is the amplitude in one frame. Some have a background.
"""

from collections.abc import Iterable, Iterator
import dataclasses
from dataclasses import dataclass
import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import named, ParameterError, suggestion
from track_before_detect.options import checked_value, declared
from track_before_detect.simulation.backdrop import backdrop, LAYERS
from track_before_detect.simulation.motions import direction, place_targets
from track_before_detect.simulation.sensor import add_streak


def _parameter(default: Any, description: str, **limits: Any) -> Any:
    """Declare one parameter, of the kind of its default."""
    kind = {int: 'integer', float: 'number', str: 'text'}[type(default)]
    return declared(default, description, kind=kind, **limits)


@dataclass(frozen=True)
class Scenario:
    """Parameters of a simulated recording, checked when made."""

    description: str = ''
    height: int = _parameter(128, 'Rows.', unit='px', minimum=8, maximum=8192)
    width: int = _parameter(128, 'Columns.', unit='px', minimum=8, maximum=8192)
    n_frames: int = _parameter(20, 'Frames.', minimum=1, maximum=100000)
    fps: float = _parameter(25.0, 'Frames per second.', unit='Hz', above=0.0, maximum=1e6)
    psf_sigma_px: float = _parameter(
        1.0, 'Standard deviation of the point spread function.', unit='px', minimum=0.3,
        maximum=20.0)
    exposure_s: float = _parameter(
        0.0, 'Time for which the shutter is open, around the stamp of a frame: a target is '
        'smeared along its motion, and its amplitude that of the smeared picture scaled to unit '
        'norm.', unit='s', minimum=0.0, maximum=1e6)
    n_targets: int = _parameter(1, 'Targets.', minimum=0, maximum=1000)
    snr: float = _parameter(
        3.0, 'Amplitude over noise standard deviation in one frame; its root mean square when '
        'the amplitude fluctuates.', minimum=0.0, maximum=1e6)
    snr_spread: float = _parameter(
        1.0, 'Each target has its own SNR, between snr and snr_spread times snr.', minimum=1.0,
        maximum=100.0)
    fluctuation: str = _parameter(
        'none', 'How the amplitude changes from frame to frame; rayleigh: independent, with '
        'exponential power.', choices=('none', 'rayleigh'))
    motion: str = _parameter(
        'lines', 'Straight lines, arcs with a random turn rate, an arc of given radius, two '
        'targets that cross, or that fly side by side; range_doppler: rows are range bins, '
        'through which the column, a Doppler bin, moves the target.',
        choices=('lines', 'turns', 'arc', 'crossing', 'parallel', 'range_doppler'))
    speed_px_per_frame: float = _parameter(
        1.0, 'Largest speed; lines and turns draw the speed of each target up to it, the other '
        'motions have it.', unit='px/frame', minimum=0.0, maximum=1000.0)
    turn_rate_rad_per_frame: float = _parameter(
        0.0, 'Largest turn rate of turns.', unit='rad/frame', minimum=0.0, maximum=math.pi)
    radius_px: float = _parameter(
        20.0, 'Radius of the arc.', unit='px', above=0.0, maximum=1e6)
    range_bins_per_doppler_bin: float = _parameter(
        1.0, 'Range bins a second that a target of motion range_doppler moves by for each column '
        'right of the middle one (the number of columns halved, rounded down).', unit='1/s',
        minimum=-1e6, maximum=1e6)
    doppler_drift_bins: float = _parameter(
        0.0, 'Largest change of the Doppler of a target over the recording, at a constant rate.',
        unit='px', minimum=0.0, maximum=1e6)
    doppler_ambiguities: int = _parameter(
        0, 'By how many times the number of columns the Doppler of a target of motion '
        'range_doppler may be off the map, either way; with more than none its columns go round.',
        minimum=0, maximum=16)
    separation_px: float = _parameter(
        12.0, 'Least distance of two targets in any frame; the distance of parallel ones; not '
        'used by crossing.', unit='px', minimum=0.0, maximum=1e6)
    background_rms: float = _parameter(
        0.0, 'Standard deviation of a background like clouds and ground, with details of all '
        'sizes; 0 is none.', minimum=0.0, maximum=1e6)
    background_speed_px_per_frame: float = _parameter(
        0.0, 'Speed at which the background passes through the picture, in a direction of its '
        'own, as clouds drift or a camera turns; targets move through the picture all the same.',
        unit='px/frame', minimum=0.0, maximum=1000.0)
    sensor: int = _parameter(
        0, 'Which of several sensors this is, which see the same targets, each with noise and '
        'background of its own.', minimum=0, maximum=1000)
    view_x_px: float = _parameter(
        0.0, 'Column in the frames of sensor 0 at which those of this one begin.', unit='px',
        minimum=-1e6, maximum=1e6)
    view_y_px: float = _parameter(
        0.0, 'Row in the frames of sensor 0 at which those of this one begin.', unit='px',
        minimum=-1e6, maximum=1e6)
    border_px: float = _parameter(
        4.0, 'Least distance of a target to the edge of the frame.', unit='px', minimum=0.0,
        maximum=1e6)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.metadata:
                value = checked_value(field.name, getattr(self, field.name), field.metadata)
                object.__setattr__(self, field.name, value)
        if self.motion in ('crossing', 'parallel') and self.n_targets != 2:
            raise ParameterError(
                f'n_targets must be 2 for motion {self.motion}, got {self.n_targets}')
        if 2 * self.border_px > min(self.height, self.width) - 1:
            raise ParameterError(
                f'border_px must leave room in frames of {self.height} x {self.width}, got '
                f'{self.border_px:g}')


SCENARIOS: dict[str, Scenario] = {
    'eo_ir_drones': Scenario(
        'Electro-optical or infrared camera, three dim drones on gently curved courses.',
        n_frames=40, n_targets=3, snr=3.0, snr_spread=1.5, motion='turns',
        speed_px_per_frame=0.9, turn_rate_rad_per_frame=0.025),
    'eo_ir_clouds': Scenario(
        'Electro-optical or infrared camera that stands below drifting clouds, two drones.',
        n_frames=40, n_targets=2, snr=6.0, motion='turns', speed_px_per_frame=0.9,
        turn_rate_rad_per_frame=0.025, psf_sigma_px=1.5, background_rms=12.0,
        background_speed_px_per_frame=0.1),
    'eo_ir_turning': Scenario(
        'Electro-optical or infrared camera that turns with a drone, past ground and clouds.',
        n_frames=40, snr=6.0, motion='turns', speed_px_per_frame=0.4,
        turn_rate_rad_per_frame=0.025, psf_sigma_px=1.5, background_rms=12.0,
        background_speed_px_per_frame=1.3),
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
        Noise of standard deviation 1, targets, and what background there is.
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


@dataclass(frozen=True)
class SimulatedStream:
    """A recording of which one frame is held at a time.

    Attributes
    ----------
    frames : iterator of arrays of float32, shape (H, W)
        Each made when it is asked for, once.
    stamps, truth, scenario
        As of a :class:`SimulatedRecording`.
    """

    frames: Iterator[NDArray[np.float32]]
    stamps: NDArray[np.float64]
    truth: NDArray[np.float64]
    scenario: Scenario


def simulate(name: str, seed: int, **overrides: Any) -> SimulatedRecording:
    """Make a recording; the same arguments give the same recording.

    Parameters
    ----------
    name : str
        One of those that ``tbd simulate --list`` names.
    seed : int
        Not negative.
    **overrides
        Parameters of :class:`Scenario` to change; the noise does not depend on them as long as
        the frames keep their size.
    """
    made = stream(name, seed, **overrides)
    scenario = made.scenario
    frames = np.empty((scenario.n_frames, scenario.height, scenario.width), np.float32)
    for number, frame in enumerate(made.frames):
        frames[number] = frame
    return SimulatedRecording(frames, made.stamps, made.truth, scenario)


def stream(name: str, seed: int, **overrides: Any) -> SimulatedStream:
    """Make the recording of :func:`simulate` frame by frame."""
    scenario = _overridden(name, overrides)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ParameterError(f'seed must be a whole number, not negative, got {seed!r}')
    noise_seed, motion_seed, amplitude_seed, background_seed = (
        np.random.SeedSequence(int(seed)).spawn(4))
    for_motion, for_amplitude = map(np.random.default_rng, (motion_seed, amplitude_seed))
    for_noise, for_background = (
        np.random.default_rng(part.spawn(scenario.sensor)[-1] if scenario.sensor else part)
        for part in (noise_seed, background_seed))
    positions = place_targets(name, scenario, for_motion)
    positions -= scenario.view_x_px, scenario.view_y_px
    snr = scenario.snr * for_amplitude.uniform(1.0, scenario.snr_spread, len(positions))
    amplitudes = np.repeat(snr[:, None], scenario.n_frames, axis=1)
    if scenario.fluctuation == 'rayleigh':
        amplitudes *= np.sqrt(for_amplitude.exponential(1.0, amplitudes.shape))
    if scenario.doppler_ambiguities:
        # Columns go round.
        positions[..., 0] = (positions[..., 0] + 0.5) % scenario.width - 0.5
    truth = [np.column_stack([np.arange(len(path)), np.full(len(path), target), path])
             for target, path in enumerate(positions)]
    return SimulatedStream(
        _frames(scenario, positions, amplitudes, for_noise, for_background),
        np.arange(scenario.n_frames) / scenario.fps,
        np.concatenate(truth) if truth else np.zeros((0, 4)), scenario)


def _frames(scenario: Scenario, positions: NDArray, amplitudes: NDArray,
            for_noise: np.random.Generator,
            for_background: np.random.Generator) -> Iterator[NDArray[np.float32]]:
    """Yield frames with targets (N, T, 2) of amplitudes (N, T)."""
    shape = (scenario.n_frames, scenario.height, scenario.width)
    streaks = np.zeros(positions.shape)
    if scenario.exposure_s and scenario.n_frames > 1:
        streaks = scenario.exposure_s * scenario.fps * np.gradient(positions, axis=1)
    # Columns that go round show a target at both edges.
    turns = (-1, 0, 1) if scenario.doppler_ambiguities else (0,)
    pictures: Iterable[NDArray | float] = itertools.repeat(0.0, scenario.n_frames)
    if scenario.background_rms:
        layers = {scale: scenario.background_rms * share for scale, share in LAYERS.items()}
        step = scenario.background_speed_px_per_frame * direction(
            for_background.uniform(0.0, 2.0 * math.pi))
        pictures = backdrop(for_background, shape, layers, step)
    for number, picture in enumerate(pictures):
        frame = for_noise.standard_normal(shape[1:], np.float32)
        frame += picture
        for (x, y), amplitude, streak in zip(
                positions[:, number], amplitudes[:, number], streaks[:, number], strict=True):
            for turn in turns:
                add_streak(frame, x + turn * scenario.width, y, scenario.psf_sigma_px, amplitude,
                           streak)
        yield frame


def _overridden(name: str, overrides: dict[str, Any]) -> Scenario:
    """Return the scenario of that name with some parameters changed."""
    scenario = named('scenario', name, SCENARIOS)
    names = [field.name for field in dataclasses.fields(Scenario) if field.metadata]
    for key in overrides:
        if key not in names:
            raise ParameterError(
                f'unknown parameter {key!r} of a scenario; {suggestion(key, names)}')
    return dataclasses.replace(scenario, **overrides)
