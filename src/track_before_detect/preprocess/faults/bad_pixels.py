"""Pixels that hold no picture: telemetry, symbols, dead, hot and saturated pixels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.preprocess.background import temporal_median, with_nearest
from track_before_detect.preprocess.per_frame import shown
from track_before_detect.preprocess.robust import robust_deviation

_WIDEST_STRIP = 8  # rows or columns from the border that may hold counters and clocks
_JUMP = 20.0  # noise deviations by which a strip jumps off the picture
_LEAST_SHARE = 0.5  # of its pixels that do
_HOT = 10.0  # noise deviations by which a hot pixel stands out of its neighbours in every frame
_MOST_SPILLED = 0.1  # share of that in the nearest pixels: the sharpest PSF leaves them more
_ALIVE = 0.5  # noise deviations by which the pixels around a dead one vary at least
_LEAST_LEVELS = 2.0  # the same in grey levels, or rounding alone keeps a pixel as it is
_MOST_PIXELS = 0.01  # share of the pixels above which what stands out is the picture
_WIDTHS = 8.0  # extent of what is too large for a target, in standard deviations of one
_LEAST_EXTENT_PX = 12
_PILED_UP = 10.0  # times as many pixels at the largest value as at the next lower one
_BLOOMING_PX = 2  # around saturated pixels
_BESIDE_PX = 5  # from a symbol to what says the level around it
_RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)
_AROUND = np.ones((3, 3), bool)


@dataclass(frozen=True)
class BadPixels:
    """Which pixels hold no picture.

    Attributes
    ----------
    mask : array of bool, shape (T, H, W)
        True where one does not.
    remarks : dict of str to str
        A sentence for each kind that was found.
    """

    mask: NDArray[np.bool_]
    remarks: dict[str, str]


@dataclass(frozen=True)
class _Seen:
    """What the frames with data show: the frames, and their noise.

    ``middle``, ``low`` and ``high`` are median and range of each pixel over time.
    """

    frames: NDArray
    deviation: float
    middle: NDArray
    low: NDArray
    high: NDArray

    def ends(self, mask: NDArray[np.bool_]) -> list[float]:
        """Return the least and the largest value of the pixels that are not masked."""
        known = ~mask & np.isfinite(self.low)
        return [float(self.low[known].min()), float(self.high[known].max())] if known.any() else []


def bad_pixels(frames: NDArray, width_px: float = 1.0) -> BadPixels:
    """Find the pixels of a batch that hold no picture.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values as they came, NaN where masked; at least 3 frames that hold any.
    width_px : float, optional
        Standard deviation in pixels of a target, which is no saturated area.
    """
    mask = np.zeros(frames.shape, bool)
    remarks: dict[str, str] = {}
    has_data = shown(frames)
    with_data = frames if has_data.all() else frames[has_data]
    if len(with_data) < 3:
        return BadPixels(mask, remarks)
    deviation = robust_deviation(np.diff(with_data, axis=0)) / 2**0.5
    if deviation > 0:
        seen = _Seen(with_data, deviation, temporal_median(with_data),
                     with_data.min(axis=0), with_data.max(axis=0))
        always = np.zeros(frames.shape[1:], bool)
        for mask_kind in (_mask_strips, _mask_single_pixels, _mask_symbols):
            mask_kind(always, remarks, seen)
        mask |= always
    saturated = _saturated(np.where(mask, np.nan, frames) if mask.any() else frames,
                           max(_LEAST_EXTENT_PX, _WIDTHS * width_px))
    if saturated.any():
        mask |= saturated
        remarks['saturated'] = 'saturated areas are masked, with their border'
    return BadPixels(mask, remarks)


def _mask_strips(mask: NDArray[np.bool_], remarks: dict[str, str], seen: _Seen) -> None:
    """Mask the lines at each border that jump off the picture beside them in every frame."""
    for axis, name in ((0, 'row'), (1, 'column')):
        for last in (False, True):
            lines = np.moveaxis(seen.frames, axis + 1, 1)
            lines = lines[:, ::-1] if last else lines
            n_lines = lines.shape[1]
            width = _strip_width(np.ascontiguousarray(lines[:, :_WIDEST_STRIP + 4]),
                                 min(_WIDEST_STRIP, n_lines // 4), seen.deviation)
            if not width:
                continue
            first, end = (n_lines - width, n_lines) if last else (0, width)
            np.moveaxis(mask, axis, 0)[first:end] = True
            which = f'{name} {first} is' if width == 1 else f'{name}s {first} to {end - 1} are'
            remarks[f'{name} {last}'] = f'{which} masked: no part of the picture'


def _strip_width(lines: NDArray, widest: int, deviation: float) -> int:
    """Return how many of the first lines (T, lines, pixels) are no part of the picture."""
    for width in range(widest, 0, -1):
        # a steep scene changes as much from line to line within the picture
        slope = np.abs(lines[:, width:width + 3] - lines[:, width + 1:width + 4]).max(axis=1)
        jumps = np.abs(lines[:, width - 1] - lines[:, width]) > _JUMP * deviation + 2 * slope
        if np.mean(jumps, axis=1).min() >= _LEAST_SHARE:
            return width
    return 0


def _mask_single_pixels(mask: NDArray[np.bool_], remarks: dict[str, str], seen: _Seen) -> None:
    """Mask hot pixels, which stand out of all neighbours, and dead ones, which never change."""
    unknown = mask | ~np.isfinite(seen.middle)
    middle = with_nearest(seen.middle, unknown)
    highest, lowest = (limit(middle, footprint=_RING)
                       for limit in (ndimage.maximum_filter, ndimage.minimum_filter))
    jump = _HOT * seen.deviation
    lonely = np.maximum(middle - highest, lowest - middle) > (1 - _MOST_SPILLED) * jump
    # a bright target that hovers does not change either, at the end of the range
    still = (seen.low == seen.high) & ~np.isin(seen.low, seen.ends(mask))
    is_whole = np.array_equal(middle, np.rint(2 * middle) / 2)
    least = max(_ALIVE * seen.deviation, _LEAST_LEVELS if is_whole else 0.0)

    def is_hot(patch: NDArray) -> bool:
        excess = np.abs(patch - np.median(patch))
        around = np.delete(excess[1:4, 1:4].ravel(), 4).max()
        return excess[2, 2] > jump and around < _MOST_SPILLED * excess[2, 2]

    for kind, candidates, values, is_bad in (
            ('hot', lonely, lambda: middle, is_hot),
            ('dead', still, lambda: np.std(seen.frames, axis=0),
             lambda patch: np.median(patch) > least)):
        places = np.argwhere(candidates & ~mask)
        if not 0 < len(places) <= _MOST_PIXELS * mask.size:
            continue
        patches = np.pad(values(), 2, mode='symmetric')
        found = np.zeros_like(mask)
        for y, x in places:
            found[y, x] = is_bad(patches[y:y + 5, x:x + 5])
        if found.any():
            mask |= found
            _name(remarks, kind, found)


def _mask_symbols(mask: NDArray[np.bool_], remarks: dict[str, str], seen: _Seen) -> None:
    """Mask what is drawn into the frames: never changing, at an end of the range, sharp."""
    found = np.zeros_like(mask)
    for end in seen.ends(mask):
        drawn = ~mask & (seen.low == end) & (seen.high == end)
        middle = np.where(mask | drawn, np.nan, seen.middle)
        # what is at the end of the range by itself has neighbours that come near it
        distance = np.minimum(np.abs(seen.low - end), np.abs(seen.high - end))
        near = distance <= _HOT * seen.deviation
        labels, _ = ndimage.label(drawn, _AROUND)
        for number, place in enumerate(ndimage.find_objects(labels), start=1):
            rows, columns = (slice(max(part.start - _BESIDE_PX, 0), part.stop + _BESIDE_PX)
                             for part in place)
            own = labels[rows, columns] == number
            values = middle[rows, columns]
            known = np.isfinite(values)
            beside = ndimage.binary_dilation(own, _AROUND) & known
            around = known & ~ndimage.binary_dilation(own, _AROUND, 2)
            if not beside.any() or not around.any():
                continue
            level = np.median(values[around])
            # the flanks of a target are as soft as its point spread function
            spilled = (np.mean(values[beside]) - level) / (end - level)
            if spilled < _MOST_SPILLED and np.mean(near[rows, columns][beside]) < _MOST_SPILLED:
                found[rows, columns] |= own
    if found.any():
        mask |= found
        _name(remarks, 'burnt-in', found)


def _saturated(frames: NDArray, extent_px: float) -> NDArray[np.bool_]:
    """Return the areas at the largest value that are larger than a target, and their border."""
    found = np.zeros(frames.shape, bool)
    highest = np.fmax.reduce(frames, axis=None)
    n_highest = np.count_nonzero(frames == highest)
    if n_highest < extent_px:
        return found
    below = frames[frames < highest]
    if not below.size or n_highest < _PILED_UP * np.count_nonzero(below == below.max()):
        return found
    for frame, own in zip(frames, found, strict=True):
        labels, _ = ndimage.label(frame == highest, _AROUND)
        many = np.bincount(labels.ravel()) > extent_px
        places = ndimage.find_objects(labels)
        for number in np.flatnonzero(many[1:]) + 1:
            place = places[number - 1]
            if max(part.stop - part.start for part in place) > extent_px:
                own[place] |= labels[place] == number
        own[:] = ndimage.binary_dilation(own, _AROUND, _BLOOMING_PX)
    return found


def _name(remarks: dict[str, str], kind: str, found: NDArray[np.bool_]) -> None:
    """Say how many pixels of a kind there are."""
    y, x = np.argwhere(found)[0]
    count = int(found.sum())
    pixels = 'pixel is' if count == 1 else 'pixels are'
    remarks[kind] = f'{count} {kind} {pixels} masked, the first at x = {x}, y = {y}'
