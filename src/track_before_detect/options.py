"""Every option of the detector, declared once.

The Python call, ``--set`` on the command line, YAML files and the parameters of the node are all
read from the fields of :class:`DetectorOptions`: type, default, unit, range and description.
``None`` means automatic; where a format cannot say ``None`` (ROS parameters), 0, an empty string
or an empty list stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import difflib
from typing import Any

import numpy as np

from track_before_detect.array_option import array_option, ArrayOption
from track_before_detect.checks import checked_number
from track_before_detect.errors import ParameterError, suggestion

DETECTORS = ('convex', 'greedy', 'cfo_dp', 'cso_dp', 'mff_dp', 'cfo_dpr', 'cso_dpr', 'mff_dpr',
             'mt_dp', 'pc_dp', 'velocity_filter')
DEFAULT_CONTINUATION = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)


def declared(default: Any, description: str, *, kind: str, unit: str = '',
             choices: tuple[str, ...] | None = None, minimum: float | None = None,
             maximum: float | None = None, above: float | None = None,
             optional: bool = False) -> Any:
    """Declare one option; ``above`` is an exclusive lower bound, the others are inclusive."""
    metadata = {
        'description': description, 'kind': kind, 'unit': unit, 'choices': choices,
        'minimum': minimum, 'maximum': maximum, 'above': above, 'optional': optional,
    }
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class DetectorOptions:
    """Options of a detector, checked when made.

    ``options.describe()`` returns the unit, range and meaning of each.
    """

    detector: str = declared(
        'convex', 'Method that finds the trajectories: convex finds all jointly; for comparison, '
        'greedy finds one after the other, and dynamic programming over whole pixels of first '
        '(cfo) or second order (cso, mff), in one direction (_dp) or both (_dpr), finds one in '
        'each round; mt_dp cancels one after the other, pc_dp does so by direction; '
        'velocity_filter adds up along straight lines.',
        kind='text', choices=DETECTORS)
    psf_sigma_px: float = declared(
        1.0, 'Standard deviation of the Gaussian point spread function.', kind='number',
        unit='px', minimum=0.3, maximum=20.0)
    psf_model: str = declared(
        'gaussian', 'Whether a pixel sees the Gaussian at its centre, or its mean over the pixel.',
        kind='text', choices=('gaussian', 'integrated_gaussian'))
    psf: ArrayOption | None = declared(
        None, 'Point spread function in place of the Gaussian: an array with odd sides, the '
        'target in its middle, of any scale; between the pixels by a cubic spline. A file is '
        '.npy, .npz or an image; in Python it may also be an array.', kind='array', optional=True)
    exposure_s: float = declared(
        0.0, 'Time for which the shutter is open, around the stamp of a frame: a target is '
        'smeared along its motion during this time, and searched and fitted as a streak, whose '
        'amplitude is that at unit norm. 0 takes it as a moment.', kind='number', unit='s',
        minimum=0.0)
    max_speed_px_s: float | None = declared(
        None, 'Largest speed of a target in the registered image; automatic is one pixel per '
        'median frame interval, with calibration=clutter up to five. The convex detector still '
        'finds a bright target that is a little faster.', kind='number', unit='px/s', minimum=0.0,
        optional=True)
    max_acceleration_px_s2: float | None = declared(
        None, 'Largest acceleration of a target; automatic lets the velocity change by the '
        'maximum speed within 30 median frame intervals (motion_model range_doppler: by one '
        'Doppler bin within 10).', kind='number', unit='px/s^2', minimum=0.0, optional=True)
    motion_model: str = declared(
        'nearly_constant_velocity', 'Which motions are searched; range_doppler takes rows for '
        'range bins and columns for Doppler bins, which say how fast the range changes, '
        'range_bearing columns for bearing, of which the last lies beside the first.',
        kind='text', choices=(
            'nearly_constant_velocity', 'constant_velocity', 'static', 'range_doppler',
            'range_bearing'))
    range_bins_per_doppler_bin: float | None = declared(
        None, 'Of motion_model range_doppler, which needs it: by how many range bins a second a '
        'target moves on for each Doppler bin (metres per second of a Doppler bin over metres of '
        'a range bin), negative where a higher Doppler bin means approaching.', kind='number',
        unit='1/s', optional=True)
    doppler_offset_bins: float = declared(
        0.0, 'Of motion_model range_doppler: column of zero Doppler less the middle column, which '
        'is half the number of columns, rounded down.', kind='number', unit='px')
    doppler_ambiguities: int = declared(
        0, 'Of motion_model range_doppler: by how many times the number of columns the Doppler '
        'of a target may be off, either way; columns then go round, and how fast the range '
        'changes tells which it is: the velocity in y of a trajectory is the true range rate. '
        'With 0 they end at both sides.', kind='integer', minimum=0, maximum=16)
    directions: int | None = declared(
        None, 'Of detector pc_dp: parts of the transition set, one for each sector of directions, '
        'that are searched at the same time; automatic is 4.', kind='integer', minimum=1,
        maximum=64, optional=True)
    presence: str = declared(
        'full', 'Whether a target is there in all frames of a batch, or may enter and leave '
        '(partial), which is then found, at the cost of slightly dimmer targets.', kind='text',
        choices=('full', 'partial'))
    amplitudes: str = declared(
        'non-negative', 'Sign of a target beside the background; signed may change from frame to '
        'frame, but with calibration=clutter, where a target is bright throughout a batch or '
        'dark throughout; complex for frames of complex '
        'numbers, in which the phase of a target may be any in each frame and the noise has '
        'E|n|^2 = 1.', kind='text', choices=('non-negative', 'signed', 'complex'))
    amplitude_model: str = declared(
        'fluctuating', 'Whether the amplitude may differ from frame to frame; constant finds '
        'dimmer targets, if that of the whole target, whatever variance and mask leave of it, '
        'is. Of complex amplitudes it is the modulus that is constant, the phase stays free in '
        'each frame, and little is gained. Either searches both, each at its share of the '
        'false alarm rate, in twice the time: statistics and threshold are on the scale of '
        'fluctuating.',
        kind='text', choices=('fluctuating', 'constant', 'either'))
    false_alarm_rate: float = declared(
        0.05, 'Probability that a batch without targets yields a trajectory.', kind='number',
        above=0.0, maximum=0.5)
    threshold: float | None = declared(
        None, 'Threshold on the statistic; overrides false_alarm_rate.', kind='number',
        above=0.0, optional=True)
    continuation: tuple[float, ...] = declared(
        DEFAULT_CONTINUATION, 'Values of t from 1 (convex) to 0 (combinatorial), any list that '
        'ends with its smallest: 1 alone solves the convex problem with a certificate, over the '
        'paths of the grid, so that a target between them has to be up to a tenth brighter; 0 '
        'alone the combinatorial one from nothing.',
        kind='numbers', minimum=0.0, maximum=1.0)
    batch_length: int | None = declared(
        None, 'Frames searched together; automatic is 20 in the node, and in tbd detect for a '
        'recording of more than 40 frames. A shorter one, and in Python all frames of a call, are '
        'one batch.',
        kind='integer', unit='frames', minimum=2, optional=True)
    hop: int | None = declared(
        None, 'Frames from the start of one batch to the next; automatic is half a batch.',
        kind='integer', unit='frames', minimum=1, optional=True)
    frame_scale: str = declared(
        'linear', 'What pixels are: linear takes them as they are; of maps of complex noise, '
        'magnitude, power and decibels make its noise nearly Gaussian, and amplitudes are in '
        'units of that; auto recognises such maps.', kind='text',
        choices=('linear', 'magnitude', 'power', 'decibels', 'auto'))
    bad_frames: str = declared(
        'none', 'Whether frames that are blank, saturated, garbage, or show another scene than '
        'the others, are found, masked and named; targets are followed through them.',
        kind='text', choices=('none', 'find'))
    bad_pixels: str = declared(
        'none', 'Whether rows of telemetry, burnt-in symbols, saturated areas, dead and hot '
        'pixels are found, masked and named.', kind='text', choices=('none', 'find'))
    max_time_s: float | None = declared(
        None, 'Time that the search of a batch may take, calibration and preprocessing not '
        'counted; when it is up, what was found by then is returned with the status time_limit. '
        'It is looked at between the steps of the search, so that one over all paths is never '
        'left halfway. Automatic is no limit.', kind='number', unit='s', above=0.0,
        optional=True)
    max_memory_gb: float | None = declared(
        None, 'Memory that the search of a batch may take; with less than all its paths take at '
        'once it holds a part of them at a time, and finds the same. Where that is still too '
        'much the fastest motions are left out, with a warning. Automatic is a third of what is '
        'free, at least 1 GiB.', kind='number', unit='GB', above=0.0, optional=True)
    tile_px: int | None = declared(
        None, 'Side of the tiles in which larger frames are searched, one after the other and '
        'each with a margin of what targets cross, under one threshold; a target is found once. '
        'Memory is that of a tile, and what the frames themselves take. Automatic is no tiles.',
        kind='integer', unit='px', minimum=8, optional=True)
    registration: str = declared(
        'none', 'How frames are aligned before the search: by a shift, or also by a turn and a '
        'zoom (affine) and a slope of the scene (homography); auto takes for each batch the '
        'simplest of none, translation and affine beside which no other leaves less of the '
        'scene.', kind='text',
        choices=('none', 'translation', 'affine', 'homography', 'auto'))
    background: str = declared(
        'none', 'How the background is removed; either searches without the temporal and without '
        'the spatial median, at half the rate each, for targets that move or hover.', kind='text',
        choices=('none', 'temporal_median', 'spatial_median', 'temporal_spatial_median',
                 'either'))
    search_plane: str = declared(
        'scene', 'Where paths are straight: scene is the registered plane, image the pixels of '
        'the frames as they came, for cameras that follow their targets; registration then '
        'serves the background, and tells what follows the scene.', kind='text',
        choices=('scene', 'image'))
    noise: str = declared(
        'none', 'How the noise level is found: none takes a standard deviation of 1, robust '
        'estimates one number per frame, map one per pixel, local one per pixel and frame from '
        'what lies around.', kind='text', choices=('none', 'robust', 'map', 'local'))
    calibration: str = declared(
        'noise', 'Where the threshold comes from: noise searches simulated noise; clutter goes on '
        'from the strongest paths of the batch itself, less its targets, where what is left of a '
        'scene is no noise. Statistics are then in units of their threshold, which is 1, and what '
        'lies on the border, lives in one frame, follows the scene or is longer than a target is '
        'rejected.', kind='text', choices=('noise', 'clutter'))
    variance: ArrayOption | None = declared(
        None, 'Variance of the noise of each pixel, an array (H, W) or (frames, H, W) or a file '
        '(.npy, .npz or an image); with noise=robust its scale does not matter. Where it is not '
        'finite a pixel counts as masked. Multiplied by w^2 it weighs paths by a diagonal W: the '
        'threshold then is on |W^-1 h|.', kind='array', optional=True)
    mask: ArrayOption | None = declared(
        None, 'Pixels that hold no data, an array (H, W) or (frames, H, W) or a file (.npy, .npz '
        'or an image); masked where it is not 0.', kind='array', optional=True)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = checked_value(field.name, getattr(self, field.name), field.metadata)
            object.__setattr__(self, field.name, value)
        if self.continuation[-1] > min(self.continuation):
            raise ParameterError(
                f'continuation must end with its smallest value, which says what is solved, got '
                f'{", ".join(f"{t:g}" for t in self.continuation)}')
        if self.hop is not None and self.batch_length is not None:
            if self.hop > self.batch_length:
                raise ParameterError(
                    f'hop must be at most batch_length ({self.batch_length}), got {self.hop}: '
                    'frames between batches would never be searched')

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> DetectorOptions:
        """Make options from names and values; an unknown name is refused."""
        names = [field.name for field in dataclasses.fields(cls)]
        for name in values:
            if name not in names:
                raise ParameterError(f'unknown option {name!r}; {suggestion(name, names)}')
        return cls(**values)

    def replace(self, **changes: Any) -> DetectorOptions:
        """Return a copy with some options changed."""
        return dataclasses.replace(self, **changes)


def parse_option(name: str, text: str) -> Any:
    """Read the value of one option from the text of ``KEY=VALUE``.

    Lists are separated by commas; ``auto`` or nothing stands for automatic.
    """
    fields = {field.name: field for field in dataclasses.fields(DetectorOptions)}
    if name not in fields:
        DetectorOptions.from_mapping({name: text})
    metadata = fields[name].metadata
    if metadata['optional'] and text.strip() in ('', 'auto', 'none', 'null'):
        return None
    if metadata['kind'] in ('text', 'array'):
        return text.strip()
    if metadata['kind'] == 'numbers':
        return [part for part in text.strip().strip('[]()').split(',') if part.strip()]
    return text


def describe() -> list[dict[str, Any]]:
    """Return name, default, kind, unit, range, choices and description of every option."""
    return [{'name': field.name, 'default': field.default, **field.metadata}
            for field in dataclasses.fields(DetectorOptions)]


def is_neutral(value: Any) -> bool:
    """Return whether a ROS parameter stands for automatic: it is 0, or an empty text or list."""
    if isinstance(value, (str, list, tuple)):
        return not len(value)
    return value == 0 and not isinstance(value, (bool, np.bool_))


def range_words(option: Mapping[str, Any]) -> list[str]:
    """Return what an option allows, in words for a list of facts.

    Parameters
    ----------
    option : mapping
        With choices and bounds, such as an entry of :func:`describe`.
    """
    words = ['one of ' + ', '.join(option['choices'])] if option['choices'] else []
    bounds = (('above', 'above'), ('at least', 'minimum'), ('at most', 'maximum'))
    return words + [f'{word} {option[key]:g}' for word, key in bounds if option[key] is not None]


def checked_value(name: str, value: Any, metadata: Mapping[str, Any]) -> Any:
    """Return ``value`` in the type of its option, or raise ParameterError.

    Parameters
    ----------
    name : str
        Of the option.
    value : object
        What it was given; a number may come as text.
    metadata : mapping
        As :func:`declared` made it.
    """
    if value is None:
        if metadata['optional']:
            return None
        raise ParameterError(f'{name} must not be empty')
    kind = metadata['kind']
    if kind == 'text':
        if value not in metadata['choices']:
            close = difflib.get_close_matches(str(value), metadata['choices'], n=1)
            hint = f'; did you mean {close[0]}?' if close else ''
            raise ParameterError(
                f'{name} must be one of {", ".join(metadata["choices"])}, got {value!r}{hint}')
        return value
    if kind == 'array':
        return array_option(name, value)
    bounds = {key: metadata[key] for key in ('above', 'minimum', 'maximum', 'unit')}
    if kind == 'numbers':
        if isinstance(value, (str, bytes)) or np.ndim(value) != 1 or not len(value):
            raise ParameterError(f'{name} must be a list of numbers, got {value!r}')
        return tuple(checked_number(name, _read_number(item), **bounds) for item in value)
    return checked_number(name, _read_number(value), whole=kind == 'integer', **bounds)


def _read_number(value: Any) -> Any:
    """Return the number that a text holds, such as one of the command line."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value
