"""The parameters of a simulated recording."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
import math
from typing import Any

from track_before_detect.errors import ParameterError


def _parameter(default: Any, description: str, *, unit: str = '', minimum: float | None = None,
               maximum: float | None = None, above: float | None = None,
               choices: tuple[str, ...] | None = None) -> Any:
    """Declare one parameter; ``above`` is an exclusive lower bound, the others are inclusive."""
    return dataclasses.field(default=default, metadata={
        'description': description, 'unit': unit, 'minimum': minimum, 'maximum': maximum,
        'above': above, 'choices': choices})


def _checked(field: dataclasses.Field, value: Any) -> Any:
    """Return a parameter in the type of its default, or raise ParameterError."""
    metadata = field.metadata
    if metadata['choices']:
        if value not in metadata['choices']:
            raise ParameterError(
                f'{field.name} must be one of {", ".join(metadata["choices"])}, got {value!r}')
        return value
    kind: Any = type(field.default)
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)
        if not math.isfinite(number) or (kind is int and number != int(number)):
            raise ValueError
    except (TypeError, ValueError):
        what = 'a whole number' if kind is int else 'a number'
        raise ParameterError(f'{field.name} must be {what}, got {value!r}') from None
    unit = f' {metadata["unit"]}' if metadata['unit'] else ''
    if metadata['above'] is not None and not number > metadata['above']:
        raise ParameterError(
            f'{field.name} must be above {metadata["above"]:g}{unit}, got {number:g}')
    if metadata['minimum'] is not None and number < metadata['minimum']:
        raise ParameterError(
            f'{field.name} must be at least {metadata["minimum"]:g}{unit}, got {number:g}')
    if metadata['maximum'] is not None and number > metadata['maximum']:
        raise ParameterError(
            f'{field.name} must be at most {metadata["maximum"]:g}{unit}, got {number:g}')
    return kind(number)


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
    border_px: float = _parameter(
        4.0, 'Least distance of a target to the edge of the frame.', unit='px', minimum=0.0,
        maximum=1e6)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.metadata:
                value = _checked(field, getattr(self, field.name))
                object.__setattr__(self, field.name, value)
        if self.motion in ('crossing', 'parallel') and self.n_targets != 2:
            raise ParameterError(
                f'n_targets must be 2 for motion {self.motion}, got {self.n_targets}')
        if 2 * self.border_px > min(self.height, self.width) - 1:
            raise ParameterError(
                f'border_px must leave room in frames of {self.height} x {self.width}, got '
                f'{self.border_px:g}')
