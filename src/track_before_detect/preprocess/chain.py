"""From raw frames to frames in which the noise has unit variance and the scene stands still."""

from __future__ import annotations

from dataclasses import dataclass
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.background import (
    remove_spatial_median,
    remove_temporal_median,
)
from track_before_detect.preprocess.noise import (
    correlation_factor,
    frame_level,
    pixel_level,
)
from track_before_detect.preprocess.registration import register_translation, shift_whole
from track_before_detect.types import FrameBatch

_QUANTISED_FLOOR = 0.3  # of a grey level: rounding alone adds 1/sqrt(12)

_LEAST_FRAMES = 3  # that tell what stands still from what moves
_LEAST_MESH_PX = 12  # cells this small follow the shading of a lens under a panning camera
_MESH_SIGMAS = 8  # side of a cell, of which a target must cover little

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PreparedBatch:
    """Frames ready for the search.

    Attributes
    ----------
    frames : array of float32 or complex64, shape (T, H, W)
        Pixel values on the registered plane in units of the noise standard deviation, NaN where
        masked.
    stamps : array, shape (T,)
        Seconds.
    frame_indices : array of int, shape (T,)
        Number of each frame in the recording.
    noise_level : array, shape (T, 1, 1), (1, H, W) or (1, 1, 1)
        Multiply by it to return to the units of the input; NaN where masked.
    offsets : array, shape (T, 2)
        Original position = registered position + ``offsets[t]``, x and y in whole pixels.
    fractions : array, shape (T, 2)
        What rounding left of the offset of the scene, at most half a pixel: a target that stands
        still in the scene is seen ``fractions[t]`` away from where it is on average.
    """

    frames: NDArray
    stamps: NDArray[np.float64]
    frame_indices: NDArray[np.int64]
    noise_level: NDArray[np.float64]
    offsets: NDArray[np.float64]
    fractions: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.frames)


def prepare(batch: FrameBatch, options: DetectorOptions) -> PreparedBatch:
    """Register frames, take off the background and scale the noise to one, each if asked for.

    Parameters
    ----------
    batch : FrameBatch
        Frames as they came; left as they are.
    options : DetectorOptions
        ``registration``, ``background`` and ``noise`` say what is done.

    Returns
    -------
    PreparedBatch
        New arrays; where a step is not asked for, its part of the input is passed on.
    """
    raw = np.asarray(batch.frames)
    frames = _checked_frames(raw, batch)
    n_frames = len(frames)
    if np.iscomplexobj(frames):
        if options.registration != 'none':
            raise ParameterError(
                f'registration must be none for complex frames, got {options.registration!r}')
        if options.background not in ('none', 'temporal_median'):
            raise ParameterError(
                'background must be none or temporal_median for complex frames, got '
                f'{options.background!r}')

    for name, over_time in (('background', ('temporal_median', 'temporal_spatial_median')),
                            ('noise', ('map',))):
        value = getattr(options, name)
        if value in over_time and n_frames < _LEAST_FRAMES:
            raise DataError(
                f'{name}={value} needs at least {_LEAST_FRAMES} frames, got {n_frames}')

    offsets = np.zeros((n_frames, 2))
    if options.registration == 'translation':
        registration = register_translation(frames)
        offsets = registration.offsets
        doubtful = np.flatnonzero(~registration.credible)
        if doubtful.size:
            _logger.warning(
                'registration found no shift for %d of %d frames (the first is %d); theirs is '
                'taken from the frames around', doubtful.size, n_frames,
                batch.frame_indices[doubtful[0]])
    whole = np.rint(offsets) + 0.0  # no negative zero
    fractions = offsets - whole
    if whole.any():
        frames = np.stack([shift_whole(frame, offset)
                           for frame, offset in zip(frames, whole, strict=True)])

    # a complex pixel is two real ones with half the variance each
    is_complex = np.iscomplexobj(frames)
    parts = frames.view(np.float32) if is_complex else frames
    if options.background in ('temporal_median', 'temporal_spatial_median'):
        parts = remove_temporal_median(parts, fractions)
    if options.background in ('spatial_median', 'temporal_spatial_median'):
        parts = remove_spatial_median(parts, _mesh_px(options.psf_sigma_px))
    floor = _QUANTISED_FLOOR if np.issubdtype(raw.dtype, np.integer) else 0.0
    level = _noise_level(parts, options.noise, floor)
    if is_complex:
        frames = parts.view(np.complex64)
        level = level * np.sqrt(2.0)
        if level.shape[2] > 1:
            level = np.sqrt(0.5 * (level[..., 0::2] ** 2 + level[..., 1::2] ** 2))
    else:
        frames = parts
    if options.noise == 'none':
        level = np.ones((1, 1, 1))
    else:
        frames = frames / level.astype(np.float32)
        if not is_complex:
            factor = correlation_factor(frames, options.psf_sigma_px)
            frames, level = frames / np.float32(factor), level * factor
    return PreparedBatch(
        frames, np.array(batch.stamps, dtype=np.float64), np.array(batch.frame_indices),
        level, whole, fractions)


def _checked_frames(raw, batch):
    """Return a copy of the frames in single precision, NaN where not finite."""
    if raw.ndim != 3 or 0 in raw.shape:
        raise DataError(f'frames must have shape (T, H, W) with no empty side, got {raw.shape}')
    if raw.dtype == bool or not np.issubdtype(raw.dtype, np.number):
        raise DataError(f'frames must hold numbers, got {raw.dtype}')
    if len(batch.stamps) != len(raw) or len(batch.frame_indices) != len(raw):
        raise DataError(
            f'{len(raw)} frames need as many stamps and frame numbers, got '
            f'{len(batch.stamps)} and {len(batch.frame_indices)}')
    kind = np.complex64 if np.iscomplexobj(raw) else np.float32
    with np.errstate(over='ignore'):
        frames = raw.astype(kind)
    if not np.issubdtype(raw.dtype, np.integer):
        masked = ~np.isfinite(frames)
        if masked.all():
            raise DataError(f'no pixel of the {len(raw)} frames is finite')
        frames[masked] = complex(np.nan, np.nan) if kind is np.complex64 else np.nan
    return frames


def _mesh_px(psf_sigma_px):
    """Return a cell side of which a target covers little."""
    return max(_LEAST_MESH_PX, round(_MESH_SIGMAS * psf_sigma_px))


def _noise_level(parts, method, floor):
    """Return the level that broadcasts to ``parts``, NaN where nothing is known."""
    if method == 'none':
        return np.ones((1, 1, 1))
    level = pixel_level(parts, floor) if method == 'map' else frame_level(parts, floor)
    if not np.any(level > 0):
        raise DataError(
            f'the noise level of the frames is 0, which noise={method} cannot scale to 1')
    return np.where(level > 0, level, np.nan)
