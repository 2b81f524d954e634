"""Options for a kind of sensor by name, and those that a look at the first frames proposes.

What the user tells always wins, option by option.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.capabilities import check_options
from track_before_detect.errors import ParameterError, suggestion
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.amplitude_scale import recognised_scale
from track_before_detect.preprocess.prepare import frames_beyond
from track_before_detect.preprocess.registration.registration import register
from track_before_detect.preprocess.robust import robust_deviation
from track_before_detect.preprocess.whiteness import (
    coloured_noise_factor,
    differ_by_white_noise,
)

if TYPE_CHECKING:
    from track_before_detect.tracking.recording import FrameSequence

AUTO, NONE = 'auto', 'none'
# Frames that are looked at, and those among which they are looked for: some sensors begin blank.
FRAMES_SEEN = 20
_FRAMES_READ = 1000
# Of each of several sensors in a batch, and those that are looked at.
FRAMES_OF_SENSOR = 10
# What the picture of one of several sensors may move within these.
STANDS_STILL_PX = 0.5
# Difference of level, deviation and correlation of successive frames to those of simulated noise
# within which frames are taken for it, the last where so many deviations are more.
NEAR_UNIT = 0.05
UNCORRELATED = 5.0
# Deviations beyond which a pixel belongs to a target.
STRONG = 4.0
# Width of the PSF where white noise is what targets have to stand out from, px.
SHARP_PX = 1.0

_SCENE: Mapping[str, Any] = {
    'background': 'either', 'noise': 'local', 'calibration': 'clutter', 'amplitudes': 'signed',
    'psf_sigma_px': 1.5, 'batch_length': 16, 'hop': 8, 'bad_frames': 'find',
    'bad_pixels': 'find'}
PRESETS: Mapping[str, Mapping[str, Any]] = {
    NONE: {},
    'eoir_static': _SCENE,
    'eoir_moving': {**_SCENE, 'registration': 'auto', 'search_plane': 'image'},
    'radar_range_doppler': {
        'motion_model': 'range_doppler', 'background': 'temporal_median', 'noise': 'map',
        'batch_length': 20},
    'radar_range_bearing': {
        'motion_model': 'range_bearing', 'background': 'temporal_median', 'noise': 'map',
        'batch_length': 20},
    'astronomy': {
        'registration': 'translation', 'background': 'temporal_spatial_median', 'noise': 'map',
        'presence': 'partial', 'batch_length': 20},
}


class Choice(NamedTuple):
    """Options for a recording.

    Attributes
    ----------
    options : DetectorOptions
    reasons : list of str
        Why, a sentence for each thing seen.
    """

    options: DetectorOptions
    reasons: list[str]


def choose_options(preset: str, told: Mapping[str, Any], frames: NDArray) -> Choice:
    """Return the options of a preset, overridden by those that were told.

    Parameters
    ----------
    preset : str
        ``'auto'`` or a name of :data:`PRESETS`.
    told : mapping
        Names and values of options.
    frames : array, shape (T, H, W)
        The first frames of the recording or stream, for ``'auto'``.

    Raises
    ------
    ParameterError
        There is no such preset or option, or a value is out of range.
    """
    names = [AUTO, *PRESETS]
    if preset not in names:
        raise ParameterError(f'unknown preset {preset!r}; {suggestion(preset, names)}')
    if preset == AUTO:
        chosen, reasons = _chosen(np.asarray(frames))
    else:
        chosen, reasons = PRESETS[preset], []
    if 'batch_length' in told:
        chosen = {name: value for name, value in chosen.items() if name != 'hop'}
    elif told.get('hop') is not None and 'batch_length' in chosen:
        hop = DetectorOptions(hop=told['hop']).hop or 1
        chosen = {**chosen, 'batch_length': max(chosen['batch_length'], hop)}
    unable = told.get('detector', 'convex') != 'convex' or any(
        told.get(name, value) != value for name, value in _CLUTTER_ASKS.items())
    if unable and chosen.get('calibration') == 'clutter':
        # What only the search for what stands out from the clutter can do goes with it.
        chosen = {**chosen, **_WITHOUT_CLUTTER}
        reasons = [*reasons, 'what was told asks for a threshold from noise, which the leftovers '
                   'of a scene may pass']
    return Choice(DetectorOptions.from_mapping({**chosen, **told}), reasons)


# Options with which alone calibration=clutter goes, and what is taken without it.
_CLUTTER_ASKS = {'presence': 'full', 'amplitude_model': 'fluctuating', 'threshold': None,
                 'motion_model': 'nearly_constant_velocity', 'calibration': 'clutter'}
_WITHOUT_CLUTTER = {'calibration': 'noise', 'noise': 'robust', 'background': 'temporal_median',
                    'amplitudes': 'non-negative', 'batch_length': 20, 'hop': 10}


def choose_for(recording: FrameSequence, preset: str, told: Mapping[str, Any]) -> Choice:
    """Return the options of a preset for a recording; see :func:`choose_options`."""
    seen = _first_with_data(recording) if preset == AUTO else np.empty((0, 0, 0))
    choice = choose_options(preset, told, seen)
    check_options(choice.options)
    return choice


def _first_with_data(recording: FrameSequence) -> NDArray:
    """Return the first frames (T, H, W) with a finite pixel; the very first if there are none."""
    frames = (np.asarray(recording[index])
              for index in range(min(_FRAMES_READ, len(recording))))
    seen = list(islice((frame for frame in frames if np.isfinite(frame).any()), FRAMES_SEEN))
    return np.stack(seen or [recording[0]])


def choose_for_sensors(told: Mapping[str, Any], seen: Mapping[str, NDArray]) -> Choice:
    """Return options for several sensors by a look at the first frames of each.

    Parameters
    ----------
    told : mapping
        Names and values of options.
    seen : mapping from str to array, shape (T, H, W)
        Frames of each sensor by its name, in units of the noise that was told of it.
    """
    looks = {name: _looked_at(frames) for name, frames in seen.items()
             if np.isfinite(frames).any()}
    chosen: dict[str, Any] = {}
    reasons = [f'sensor {name} has sent no finite pixel yet' for name in seen if name not in looks]
    scenes = [name for name, look in looks.items() if look.is_scene]
    if any(look.is_complex for look in looks.values()):
        chosen = {'amplitudes': 'complex', 'noise': 'robust'}
        reasons.append('frames of complex numbers')
    elif not scenes and looks:
        reasons.append('the frames of all sensors are white noise of the deviation told, 1 unless '
                       'told: taken as they are')
    elif scenes:
        chosen = {**_WITHOUT_CLUTTER, 'batch_length': FRAMES_OF_SENSOR * max(2, len(seen)),
                  'psf_sigma_px': _SCENE['psf_sigma_px']}
        del chosen['hop']
        reasons.append(f'the frames of {" and ".join(scenes)} show a scene: background and noise '
                       'of each sensor are taken from its own frames, and the threshold from '
                       'noise, which the leftovers of a scene may pass')
        if all(look.is_white or not look.is_scene for look in looks.values()):
            chosen['psf_sigma_px'] = SHARP_PX
            reasons.append('the noise of neighbouring pixels is independent: '
                           f'psf_sigma_px={SHARP_PX:g} where a sensor has none of its own')
        scales = {look.scale for look in looks.values()}
        if len(scales) == 1 and scales != {'linear'}:
            [chosen['frame_scale']] = scales
            reasons.append(f'the pixels are {chosen["frame_scale"]} of complex noise: made nearly '
                           'Gaussian')
        moving = [f'{name} by {look.reach:.2g} px' for name, look in looks.items()
                  if look.is_scene and look.reach is not None and look.reach > STANDS_STILL_PX]
        if moving or min(looks[name].n_frames for name in scenes) < 3:
            chosen['background'] = 'spatial_median'
        if moving:
            reasons.append(f'pictures move ({", ".join(moving)}), which is not taken out where '
                           'sensors are several: background=spatial_median')
    return Choice(DetectorOptions.from_mapping({**chosen, **told}), reasons)


class _Look(NamedTuple):
    """What is seen of frames: whether they are a scene, how white its noise is, how it moves.

    ``reach`` is None where nothing tells.
    """

    is_complex: bool = False
    is_scene: bool = False
    scale: str = 'linear'
    n_frames: int = 0
    is_white: bool = False
    reach: float | None = None


def _looked_at(frames: NDArray) -> _Look:
    garbage = frames_beyond(frames)
    if garbage.sum() < len(frames):
        frames = frames[~garbage]
    if np.iscomplexobj(frames):
        return _Look(is_complex=True)
    if _is_unit_noise(frames):
        return _Look()
    look = _Look(is_scene=True, scale=recognised_scale(frames.astype(np.float32)),
                 n_frames=len(frames))
    if len(frames) < 3:
        return look
    registration = register(frames.astype(np.float32))
    told = registration.credible.mean() > 0.5
    return look._replace(
        is_white=differ_by_white_noise(frames),
        reach=float(np.ptp(registration.offsets[registration.credible], axis=0).max()) if told
        else None)


def _chosen(frames: NDArray) -> tuple[Mapping[str, Any], list[str]]:
    """Return the options that frames ask for, and why."""
    look = _looked_at(frames)
    if look.is_complex:
        return {'amplitudes': 'complex', 'noise': 'robust'}, ['frames of complex numbers']
    if not np.isfinite(frames).any():
        return {}, ['no pixel of the first frames is finite, so that they tell nothing and are '
                    'taken as they are: tell what they show by the name of a preset']
    if not look.is_scene:
        return {}, ['the frames are white noise of deviation 1: taken as they are']
    words = ['the frames show a scene: it is taken off by medians over time and over space, '
             'and what stands out from the clutter that is left is a target']
    chosen = dict(_SCENE)
    if look.scale != 'linear':
        chosen['frame_scale'] = look.scale
        words.append(f'the pixels are {look.scale} of complex noise: made nearly Gaussian')
    if look.n_frames < 3:
        return {**chosen, 'background': 'spatial_median'}, words
    if look.is_white:
        chosen['psf_sigma_px'] = SHARP_PX
        words.append(f'the noise of neighbouring pixels is independent: psf_sigma_px={SHARP_PX:g}')
    if look.reach is None:
        return chosen, [*words, 'nothing tells whether the camera moves: no registration']
    return {**PRESETS['eoir_moving'], **chosen}, [
        *words, f'the picture moves by {look.reach:.2g} px within {look.n_frames} frames: '
        'registration=auto, search on the image']


def _is_unit_noise(frames: NDArray) -> bool:
    """Return whether frames (T, H, W) can be searched as they are, as simulated ones can."""
    if not np.isfinite(frames).any():
        return True
    frames = np.where(np.isfinite(frames), frames, np.nan).astype(np.float32)
    # Without bright targets and their slopes, which are no noise but may be there.
    frames[ndimage.maximum_filter(np.abs(frames) > STRONG, (1, 7, 7))] = np.nan
    if not np.isfinite(frames).any():
        return False
    level, deviation = float(np.nanmedian(frames)), robust_deviation(frames)
    if max(abs(level), abs(deviation - 1)) > NEAR_UNIT:
        return False
    if coloured_noise_factor(frames, 1.0) > 1:
        return False
    # By signs, of which targets change few.
    same = np.sign(frames[1:]) * np.sign(frames[:-1])
    same = same[np.isfinite(same)]
    return float(np.sum(same)) <= max(NEAR_UNIT * same.size, UNCORRELATED * np.sqrt(same.size))
