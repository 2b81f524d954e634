"""From raw frames to frames in which the noise has unit variance and the scene stands still."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.checks import check_kind, checked_frames
from track_before_detect.errors import DataError, TooFewFramesError
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.amplitude_scale import nearly_gaussian, recognised_scale
from track_before_detect.preprocess.background import (
    remove_stripes,
    remove_temporal_median,
    without_spatial_median,
)
from track_before_detect.preprocess.faults.bad_pixels import bad_pixels
from track_before_detect.preprocess.faults.frame_faults import (
    at_an_end,
    frame_faults,
    other_scenes,
)
from track_before_detect.preprocess.given_pixels import given_level, masked_pixels
from track_before_detect.preprocess.noise_level import (
    frame_level,
    lasting_level,
    local_level,
    pixel_level,
    scene_level,
)
from track_before_detect.preprocess.per_frame import each_frame, KeptFrames, shown
from track_before_detect.preprocess.registration.choice import register_simply
from track_before_detect.preprocess.registration.correlation import features_of
from track_before_detect.preprocess.registration.registration import (
    register_features,
    Registration,
)
from track_before_detect.preprocess.resampling import (
    shift_whole,
    stand_still,
    warped_frames,
)
from track_before_detect.preprocess.robust import robust_deviation
from track_before_detect.preprocess.scene_noise import scene_noise
from track_before_detect.preprocess.whiteness import coloured_noise_factor
from track_before_detect.types import FrameBatch, Remark

_QUANTISED_FLOOR = 0.3  # of a grey level: rounding alone adds 1/sqrt(12)

# Single precision has 24 bits.
MOST_OVER_NOISE = 1e8
# Beyond this the sum of the squares of a frame is infinite in single precision.
MOST_VALUE = 1e15

_LEAST_FRAMES = 3  # that tell what stands still from what moves
_LEAST_MESH_PX = 12  # cells this small follow the shading of a lens under a panning camera
_MESH_SIGMAS = 8  # side of a cell, of which a target must cover little
_STILL_SCENE = ('temporal_median', 'temporal_spatial_median')
_OVER_TIME = {'background': _STILL_SCENE, 'noise': ('map',)}

@dataclass(frozen=True)
class PreparedBatch:
    """Frames on their way to the search: each step takes one and returns the next.

    Attributes
    ----------
    frames : float32 or complex64 array, shape (T, H, W)
        Pixel values, NaN where masked; after the last step in units of the noise standard
        deviation, on the registered plane.
    stamps : array, shape (T,)
        Seconds.
    frame_indices : array of int, shape (T,)
        Number of each frame in the recording.
    noise_level : float32 array, shape (T, 1, 1), (1, H, W), (T, H, W) or (1, 1, 1)
        Standard deviation of the noise in the units of the input, at the pixels of the frames as
        they came; NaN where masked.
    maps : array, shape (T, 3, 3)
        Takes the registered plane to the pixels of each frame as it came, see the module
        ``geometry``.
    weights : float32 array, shape (T, H, W) or (1, H, W), or None
        One over the noise of each pixel of ``frames``, with a median of one, zero where masked;
        None where the noise differs between frames at most.
    unit : float
        Standard deviation of the noise at a weight of one, in the units of the input.
    remarks : tuple of Remark
        What was done with pixels and frames that could not be searched as they came.
    elsewhere : array of bool, shape (T,) or (1,)
        Frames at either end that show another scene, and are masked.
    registration : Registration or None
        Where the scene is in each frame as it came; None unless that was asked for.
    scale : str
        Which the pixels of ``frames`` were recognised to be on, or told.
    scene : array, shape (T, 3, 3), or None
        The maps of ``registration`` where ``frames`` are not moved by them: what follows them is
        a part of the scene, or of what registration left of it. None elsewhere.
    """

    frames: NDArray
    stamps: NDArray[np.float64]
    frame_indices: NDArray[np.int64]
    noise_level: NDArray[np.float32]
    maps: NDArray[np.float64]
    weights: NDArray[np.float32] | None = None
    unit: float = 1.0
    remarks: tuple[Remark, ...] = ()
    elsewhere: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(1, dtype=bool))
    registration: Registration | None = None
    scale: str = 'linear'
    scene: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.frames)


def prepare(batch: FrameBatch, options: DetectorOptions, width_px: float) -> PreparedBatch:
    """Register frames, take off the background and scale the noise to one, each if asked for.

    First :func:`pictures`, then :func:`noise_of_one`.

    Parameters
    ----------
    batch : FrameBatch
        Frames as they came; left as they are.
    options : DetectorOptions
        What is done, and what is known of the pixels.
    width_px : float
        Standard deviation in pixels of a target, as the point spread function has it.
    """
    return noise_of_one(pictures(batch, options, width_px), batch, options, width_px)


def pictures(batch: FrameBatch, options: DetectorOptions, width_px: float,
             kept: KeptFrames | None = None) -> PreparedBatch:
    """Return what of a batch are pictures of its scene, and where that is: the first stage.

    It is the same whatever background is taken off then.

    Parameters
    ----------
    batch, options, width_px
        See :func:`prepare`; of the options, ``mask``, ``bad_frames``, ``bad_pixels``,
        ``frame_scale`` and ``registration``.
    kept : KeptFrames, optional
        Of the batch before.

    Returns
    -------
    PreparedBatch
        New arrays. All frames are NaN where too few of them turn out to be pictures.
    """
    kept = kept or KeptFrames()
    prepared = _without_garbage(_in_single_precision(batch), MOST_VALUE, '')
    _check_options(options, prepared)
    if options.mask is not None:
        prepared = _masked(prepared, masked_pixels(options.mask, batch))
    if options.bad_frames == 'find':
        prepared = _without_faulty_frames(prepared)
        if np.sum(shown(prepared.frames)) < _least_frames(options)[0]:
            return replace(prepared, frames=np.full_like(prepared.frames, _nan(prepared.frames)))
    if options.bad_pixels == 'find':
        prepared = _without_bad_pixels(prepared, width_px)
    prepared = _nearly_gaussian(prepared, options.frame_scale)
    if options.registration != 'none':
        prepared = _registered(prepared, options.registration, kept)
    elif options.bad_frames == 'find':
        prepared, _ = _without_other_scenes(prepared)
    return prepared


def noise_of_one(seen: PreparedBatch, batch: FrameBatch, options: DetectorOptions,
                 width_px: float, kept: KeptFrames | None = None) -> PreparedBatch:
    """Take off the background and scale the noise to one: the second stage.

    All but the last step leaves every frame on its own grid, with its noise white. The last moves
    the frames onto the registered plane: after a translation by whole pixels; after any other map
    by interpolation, which correlates the noise of neighbouring pixels and takes as much of it as
    of a small target. The matched filter of a target with a ``width_px`` of 1 or more notices
    less than 2 %; for sharper ones its noise comes out up to 15 % below one, on the safe side.

    Parameters
    ----------
    seen : PreparedBatch
        What :func:`pictures` returns; left as it is.
    batch, options, width_px
        See :func:`prepare`; of the options, ``background``, ``noise``, ``search_plane`` and
        ``variance``.
    kept : KeptFrames, optional
        Of the batch before, for the same background.

    Returns
    -------
    PreparedBatch
        Where a step is not asked for, its part of ``seen`` is passed on, and so is all of it where
        no frame shows anything.
    """
    prepared = seen
    if not shown(prepared.frames).any():
        return prepared
    if options.background in _STILL_SCENE:
        prepared = _without_still_scene(prepared)
        if options.noise == 'local':
            prepared = _with_even_noise(prepared, seen.frames)
        # No frame is again what it was in the batch before.
        kept = None
    kept = kept or KeptFrames()
    if options.background in ('spatial_median', 'temporal_spatial_median'):
        prepared = _without_shading(prepared, width_px, kept)
    if options.variance is not None:
        prepared = _divided(prepared, np.array(given_level(options.variance, batch)),
                            prepared.frames is not seen.frames)
    if options.noise != 'none':
        is_whole = np.issubdtype(np.asarray(batch.frames).dtype, np.integer)
        floor = _QUANTISED_FLOOR if is_whole and prepared.scale == 'linear' else 0.0
        prepared = _divided(
            prepared, _noise_level(prepared, options, floor, width_px, kept),
            prepared.frames is not seen.frames)
        prepared = _with_white_scale(prepared, width_px)
    if options.noise != 'local':
        # Across the PSF of a target the level of its surroundings hardly changes.
        prepared = _weighted(prepared)
    if options.registration != 'none' and options.search_plane == 'scene':
        prepared = _on_plane(prepared, options.registration)
    elif prepared.registration is not None:
        prepared = replace(
            prepared, maps=geometry.translations(np.zeros((len(prepared), 2))),
            scene=_credible(prepared.registration))
    if frames_beyond(prepared.frames, MOST_OVER_NOISE).any():
        prepared = _without_garbage(prepared, MOST_OVER_NOISE, ' times their noise')
        _check_size(prepared.frames)
    return prepared


def _in_single_precision(batch: FrameBatch) -> PreparedBatch:
    """Return a copy of a batch in single precision, NaN where not finite."""
    raw = np.asarray(batch.frames)
    checked_frames(raw)
    if len(batch.stamps) != len(raw) or len(batch.frame_indices) != len(raw):
        raise DataError(
            f'{len(raw)} frames need as many stamps and frame numbers, got '
            f'{len(batch.stamps)} and {len(batch.frame_indices)}')
    with np.errstate(over='ignore'):
        frames = raw.astype(np.complex64 if np.iscomplexobj(raw) else np.float32)
    if not np.issubdtype(raw.dtype, np.integer):
        masked = ~np.isfinite(frames)
        if masked.all():
            raise DataError(f'no pixel of the {len(raw)} frames is finite')
        frames[masked] = _nan(frames)
    return PreparedBatch(
        frames, np.array(batch.stamps, dtype=np.float64), np.array(batch.frame_indices),
        np.ones((1, 1, 1), np.float32), geometry.translations(np.zeros((len(raw), 2))))


def _check_options(options: DetectorOptions, prepared: PreparedBatch) -> None:
    """Refuse frames of another kind than the amplitudes, and too few of them for a step."""
    check_kind(prepared.frames, options.amplitudes)
    least, step = _least_frames(options)
    if len(prepared) < least:
        raise TooFewFramesError(f'{step} needs at least {least} frames, got {len(prepared)}')


def _least_frames(options: DetectorOptions) -> tuple[int, str]:
    """Return how many frames the steps need, and the step that needs them."""
    for name, choices in _OVER_TIME.items():
        value = getattr(options, name)
        if value in choices:
            return _LEAST_FRAMES, f'{name}={value}'
    return 1, ''


def _masked(prepared: PreparedBatch, masked: NDArray[np.bool_]) -> PreparedBatch:
    """Return a batch without the pixels that hold no data."""
    if not masked.any():
        return prepared
    return replace(prepared, frames=np.where(masked, _nan(prepared.frames), prepared.frames))


def _with_remark(prepared: PreparedBatch, kind: str, text: str,
                 frames: NDArray | None = None) -> PreparedBatch:
    """Return a batch with one more remark, about some of its frames (T,) if given."""
    numbers = () if frames is None else tuple(prepared.frame_indices[frames].tolist())
    return replace(prepared, remarks=(*prepared.remarks, Remark(kind, text, numbers)))


def _without_faulty_frames(prepared: PreparedBatch) -> PreparedBatch:
    """Return a batch in which frames that are no pictures are masked."""
    for kind, found in frame_faults(_values(prepared.frames)).items():
        if found.any():
            prepared = _masked(prepared, found[:, None, None])
            prepared = _with_remark(prepared, kind, f'{{frames}} masked: {kind}', found)
    return prepared


def _without_bad_pixels(prepared: PreparedBatch, width_px: float) -> PreparedBatch:
    """Return a batch in which pixels that hold no picture are masked."""
    found = bad_pixels(_values(prepared.frames), width_px)
    for kind, sentence in found.remarks.items():
        prepared = _with_remark(prepared, f'{kind} pixels', sentence)
    return _masked(prepared, found.mask)


def _nearly_gaussian(prepared: PreparedBatch, scale: str) -> PreparedBatch:
    """Return a batch whose noise is nearly Gaussian if its scale is known."""
    frames = prepared.frames
    if scale == 'auto':
        scale = recognised_scale(frames)
        if scale == 'linear':
            return prepared
        prepared = _with_remark(
            prepared, 'scale', f'frames are taken for maps of complex noise on the scale {scale}, '
            'and brought to nearly Gaussian noise')
    elif scale == 'linear':
        return prepared
    elif scale != 'decibels' and np.any(frames < 0):
        raise DataError(f'frame_scale={scale} needs pixels of at least 0, got '
                        f'{np.nanmin(frames):g}')
    return replace(prepared, frames=nearly_gaussian(frames, scale), scale=scale)


def _registered(prepared: PreparedBatch, model: str, kept: KeptFrames) -> PreparedBatch:
    """Return a batch with the map from the plane to each frame, and say what is doubtful."""
    has_data = shown(prepared.frames)
    features = kept.each(features_of, prepared.frames, prepared.frame_indices)
    registration = (register_simply(features) if model == 'auto'
                    else register_features(features, model))
    prepared = replace(prepared, maps=registration.maps, registration=registration)
    doubtful = has_data & ~registration.credible
    if doubtful.any():
        prepared, odd = _without_other_scenes(prepared)
        doubtful &= ~odd
    if doubtful.sum() > 0.5 * has_data.sum():
        prepared = _with_remark(
            prepared, 'no registration', 'registration found no shift in most frames: the scene '
            'shows too little, and may stand still')
    elif doubtful.any():
        prepared = _with_remark(
            prepared, 'registration', 'registration found no shift for {frames}: it is taken from '
            'the frames around', doubtful)
    shifted = has_data & registration.credible & ~registration.refined
    if shifted.any():
        prepared = _with_remark(
            prepared, 'refinement', f'registration={model} found no more than a shift for '
            '{frames}', shifted)
    return prepared


def _without_other_scenes(prepared: PreparedBatch) -> tuple[PreparedBatch, NDArray[np.bool_]]:
    """Return a batch in which frames are masked that do not show its scene, and which these are.

    Frames on either side of a cut are searched with those of their own scene, by the batch that
    holds more of these.
    """
    found = other_scenes(warped_frames(_values(prepared.frames), prepared.maps))
    odd = np.zeros(len(prepared), dtype=bool) if found is None else found
    elsewhere = at_an_end(odd)
    if not odd.any():
        return prepared, odd
    spoiled = odd & ~elsewhere
    if spoiled.any():
        prepared = _with_remark(prepared, 'unlike', '{frames} masked: unlike the frames around',
                                spoiled)
    if elsewhere.any():
        cut = np.flatnonzero(np.diff(elsewhere)) + 1
        prepared = _with_remark(prepared, 'cut', 'another scene from {frames} on: a batch is '
                                'searched in the scene of most of its frames', cut)
    prepared = _masked(prepared, odd[:, None, None])
    return replace(prepared, elsewhere=elsewhere), odd


def _credible(registration: Registration | None) -> NDArray[np.float64] | None:
    """Return the maps of a registration that most frames agree to."""
    if registration is None or np.mean(registration.credible) < 0.5:
        return None
    return registration.maps


def _without_still_scene(prepared: PreparedBatch) -> PreparedBatch:
    """Return a batch without what stands still on the registered plane."""
    left = remove_temporal_median(_real_parts(prepared.frames), prepared.maps)
    if not stand_still(prepared.maps):
        remove_stripes(left)
    return replace(prepared, frames=left.view(prepared.frames.dtype))


def _with_even_noise(prepared: PreparedBatch, frames: NDArray) -> PreparedBatch:
    """Return a batch whose noise follows neither brightness nor slopes of the scene."""
    noise = scene_noise(_real_parts(prepared.frames), _real_parts(frames))
    # The frames without their scene are an array of this stage.
    return prepared if noise is None else _divided(prepared, noise, True)


def _without_shading(prepared: PreparedBatch, width_px: float, kept: KeptFrames) -> PreparedBatch:
    """Return a batch without slow changes over the image, by cells a target covers little of."""
    mesh_px = max(_LEAST_MESH_PX, round(_MESH_SIGMAS * width_px))
    return replace(prepared, frames=np.stack(kept.each(
        without_spatial_median, prepared.frames, prepared.frame_indices, mesh_px)))


def _divided(prepared: PreparedBatch, level: NDArray, in_place: bool) -> PreparedBatch:
    """Return a batch in units of a level, which broadcasts to its frames.

    The level is no longer to be used, nor are the frames where they are divided ``in_place``:
    those of a batch take as much memory as little else.
    """
    level = level.astype(np.float32, copy=False)
    frames = prepared.frames if in_place else np.empty_like(prepared.frames)

    def divide(frame: NDArray, divisor: NDArray, out: NDArray) -> None:
        # part by part: a complex division by NaN warns
        parts, quotients = (whole.view(np.float32).reshape(*whole.shape, -1)
                            for whole in (frame, out))
        np.divide(parts, divisor[..., None], out=quotients)

    each_frame(divide, prepared.frames,
               np.broadcast_to(level, (len(frames), *level.shape[1:])), frames)
    before = prepared.noise_level
    whole = level.shape == np.broadcast_shapes(level.shape, before.shape)
    return replace(prepared, frames=frames,
                   noise_level=np.multiply(before, level, out=level if whole else None))


def _noise_level(prepared: PreparedBatch, options: DetectorOptions, floor: float, width_px: float,
                 kept: KeptFrames) -> NDArray:
    """Return the level that broadcasts to the frames, NaN where nothing is known."""
    method, is_off = options.noise, options.background in _STILL_SCENE
    parts, maps = _real_parts(prepared.frames), prepared.maps
    if method == 'robust':
        level = frame_level(parts, floor)
    elif method == 'local':
        level = np.stack(kept.each(local_level, parts, prepared.frame_indices, floor, width_px))
        if not is_off:
            np.maximum(level, lasting_level(parts, maps, width_px), out=level)
            level = _of_unit_bulk(parts, level, floor)
    elif stand_still(maps):
        level = pixel_level(parts, floor)
    else:
        level = scene_level(parts, maps, floor)
    if not np.any(level > 0):
        raise DataError(
            f'the noise level of the frames is 0, which noise={method} cannot scale to 1')
    level[~(level > 0)] = np.nan
    if np.iscomplexobj(prepared.frames):
        # a complex pixel is two real ones with half the variance each
        level *= 2**0.5
        if level.shape[2] > 1:
            level = np.sqrt(0.5 * (level[..., 0::2] ** 2 + level[..., 1::2] ** 2))
    return level


def _of_unit_bulk(frames: NDArray, level: NDArray, floor: float) -> NDArray:
    """Return a level, changed in place, by which the bulk of the frames has unit deviation."""
    some = np.s_[:, ::2, ::2]
    known = np.where(level[some] > 0, level[some], np.float32(np.nan))
    level *= robust_deviation(frames[some] / known) or 1.0
    return np.maximum(level, floor, out=level)


def _with_white_scale(prepared: PreparedBatch, width_px: float) -> PreparedBatch:
    """Return a batch whose matched filter has unit noise; that of complex frames is white."""
    if np.iscomplexobj(prepared.frames):
        return prepared
    factor = np.float32(coloured_noise_factor(prepared.frames, width_px))
    if factor != 1:
        # In place: what is divided by the noise is an array of this stage.
        each_frame(lambda frame: np.divide(frame, factor, out=frame), prepared.frames)
        prepared.noise_level[...] *= factor
    return prepared


def _weighted(prepared: PreparedBatch) -> PreparedBatch:
    """Return a batch with one over the noise of each pixel, where pixels differ in it."""
    level = prepared.noise_level
    if level.shape[1:] == (1, 1):
        return prepared
    known = level[np.isfinite(level)]
    unit = float(np.median(known)) if known.size else 1.0
    weights = np.nan_to_num(unit / level, nan=0.0).astype(np.float32)
    return replace(prepared, weights=weights, unit=unit)


def _on_plane(prepared: PreparedBatch, model: str) -> PreparedBatch:
    """Return a batch moved onto the registered plane, NaN where a frame does not see it."""
    maps, weights, move = prepared.maps, prepared.weights, warped_frames
    if model == 'translation':
        maps = geometry.translations(np.rint(maps[:, :2, 2]) + 0.0)  # no negative zero
        move = _shifted_whole
    if weights is not None:
        weights = move(np.broadcast_to(weights, prepared.frames.shape), maps)
        weights = np.maximum(np.nan_to_num(weights), 0)
    return replace(prepared, frames=move(prepared.frames, maps), maps=maps, weights=weights)


def _shifted_whole(frames: NDArray, maps: NDArray) -> NDArray:
    """Return every frame moved by the whole pixels of its map."""
    return np.stack([shift_whole(frame, offset)
                     for frame, offset in zip(frames, maps[:, :2, 2].astype(int), strict=True)])


def _without_garbage(prepared: PreparedBatch, most: float, unit: str) -> PreparedBatch:
    """Return a batch in which frames are masked that hold pixels beyond any, where few do."""
    found = frames_beyond(prepared.frames, most)
    if not 0 < 2 * found.sum() < np.sum(shown(prepared.frames)):
        return prepared
    value, t, place = _largest(prepared.frames)
    return _with_remark(
        _masked(prepared, found[:, None, None]), 'garbage values',
        f'{{frames}} masked: pixels must be at most {most:g}{unit}, got {value:g}{unit} in frame '
        f'{prepared.frame_indices[t]} at {place}', found)


def _check_size(frames: NDArray) -> None:
    """Refuse pixels beside whose rounding the noise would not be seen."""
    if frames_beyond(frames, MOST_OVER_NOISE).any():
        value, t, place = _largest(frames)
        raise DataError(
            f'pixels must be at most {MOST_OVER_NOISE:g} times their noise, got {value:g} times '
            f'in frame {t} of a batch at {place}: scale the frames, set noise=robust, or mask '
            'pixels that hold no data')


def frames_beyond(frames: NDArray, most: float = MOST_VALUE) -> NDArray[np.bool_]:
    """Return the frames (T,) with a pixel beyond a bound of either sign."""
    parts = frames.view(frames.real.dtype) if np.iscomplexobj(frames) else frames

    def is_beyond(frame: NDArray) -> bool:
        return bool(np.fmax.reduce(frame, axis=None) > most
                    or np.fmin.reduce(frame, axis=None) < -most)

    return np.array(each_frame(is_beyond, parts), bool)


def _largest(frames: NDArray) -> tuple[float, int, str]:
    """Return the largest modulus of all pixels, in which frame it is, and where."""
    size = np.abs(np.nan_to_num(frames, nan=0.0))
    t, y, x = np.unravel_index(int(np.argmax(size)), size.shape)
    return float(size[t, y, x]), int(t), f'x = {x}, y = {y}'


def _real_parts(frames: NDArray) -> NDArray[np.float32]:
    """Return frames as real ones, shape (T, H, 2 W) when they are complex."""
    return frames.view(np.float32)


def _values(frames: NDArray) -> NDArray[np.float32]:
    """Return what pixels show: their values, or the magnitudes of complex ones."""
    return np.abs(frames) if np.iscomplexobj(frames) else frames


def _nan(frames: NDArray) -> np.generic:
    """Return the value of a masked pixel; both parts of a complex one are NaN."""
    return frames.dtype.type(complex(np.nan, np.nan) if np.iscomplexobj(frames) else np.nan)
