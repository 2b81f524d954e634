"""Shift of the scene between frames, found by correlation, and moving images by it.

The camera moves, the scene with it: a point of the scene at position ``p`` of the reference frame
is at ``p + offsets[t]`` in frame t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

_HIGH_PASS_PX = 31  # side of the box whose mean is taken off: shading of the lens stays put
_CLIP = 3.0  # of the robust deviation, so that no bright pixel decides alone
_RING_PX = 8  # from a pixel to the four whose middle says what lies around a target
_LONELY = 0.1  # share of clipped pixels in the box below which they are targets or hot pixels
_PEAK_SIGMA_PX = 1.0  # width given to the correlation peak, so that a Gaussian fits it
_WHITENING = 0.3  # power of the spectrum divided out: 0 plain correlation, 1 phase alone
_TAPER = 0.1  # share of each side faded out, so that the border does not correlate with itself
_CREDIBLE = 8.0  # peak over the deviation of the surface; pure noise reaches 5.5
_TILE_AGREES = 2.5  # deviations of the correlation within a tile
_LEAST_TILES = 6  # of 64 that agree on a shift; one moving target may reach into four
_LEAST_OVERLAP = 0.6  # share of either side still in common with the frame compared with
_FARTHEST = 0.25  # share of the smaller side a frame may move from its neighbour


@dataclass(frozen=True)
class Registration:
    """Where the scene is in each frame.

    Attributes
    ----------
    offsets : array, shape (T, 2)
        Shift x, y in pixels of the scene in each frame against the reference frame.
    quality : array, shape (T,)
        Height of the correlation peak over the standard deviation of the correlation surface;
        infinite for the reference frame.
    credible : array of bool, shape (T,)
        False where no peak stood out and the offset was taken from neighbouring frames.
    reference : int
        Number of the reference frame within the batch.
    """

    offsets: NDArray[np.float64]
    quality: NDArray[np.float64]
    credible: NDArray[np.bool_]
    reference: int


def register_translation(frames: NDArray) -> Registration:
    """Find the shift of the scene in each frame relative to the middle one.

    Each frame is high-passed and clipped, so that neither the shading of the lens nor a bright
    target decides, and correlated with the reference frame over what both show; further away,
    with the nearest frame already placed. A frame without a credible peak gets the offset
    interpolated between its neighbours, or that of the nearest one.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values; those that are not finite are left out.

    Returns
    -------
    Registration
        Offsets, their quality and the reference.
    """
    n_frames, height, width = frames.shape
    reference = n_frames // 2
    features = [_features(frame) for frame in frames]
    offsets = np.full((n_frames, 2), np.nan)
    quality = np.zeros(n_frames)
    offsets[reference] = 0.0
    quality[reference] = np.inf
    least = _LEAST_OVERLAP * np.array([width, height])
    for order in (range(reference + 1, n_frames), range(reference - 1, -1, -1)):
        key = last = reference
        for index in order:
            guess = np.rint(offsets[last] - offsets[key]).astype(int)
            if np.any([width, height] - np.abs(guess) < least):
                key, guess = last, np.zeros(2, dtype=int)
            shift, peak = _match(features[key], features[index], guess)
            if peak < _CREDIBLE and key != last:
                shift, peak = _match(features[last], features[index], np.zeros(2, dtype=int))
                if peak >= _CREDIBLE:
                    key = last
            quality[index] = peak
            if peak >= _CREDIBLE:
                offsets[index] = offsets[key] + shift
                last = index
    credible = np.isfinite(offsets[:, 0])
    times = np.arange(n_frames)
    for axis in range(2):
        offsets[:, axis] = np.interp(times, times[credible], offsets[credible, axis])
    return Registration(offsets, quality, credible, reference)


def shift_whole(frame: NDArray, offset: NDArray) -> NDArray:
    """Move an image by whole pixels onto the registered plane.

    Parameters
    ----------
    frame : array, shape (H, W)
        Floating-point pixel values.
    offset : array of int, shape (2,)
        Offset x, y of the scene in this frame.

    Returns
    -------
    array, shape (H, W)
        ``frame`` at each position plus ``offset``, NaN where that is outside.
    """
    height, width = frame.shape
    x, y = (int(value) for value in offset)
    moved = np.full_like(frame, np.nan)
    rows = slice(max(0, -y), min(height, height - y))
    columns = slice(max(0, -x), min(width, width - x))
    if rows.stop > rows.start and columns.stop > columns.start:
        moved[rows, columns] = frame[rows.start + y:rows.stop + y,
                                     columns.start + x:columns.stop + x]
    return moved


def shift_fraction(image: NDArray, fraction: NDArray) -> NDArray:
    """Interpolate an image at every pixel plus a fraction of one, by cubic convolution.

    Parameters
    ----------
    image : array, shape (H, W)
        Floating-point pixel values; NaN spreads to pixels whose value needs it.
    fraction : array, shape (2,)
        Fractions x, y between -1 and 1.

    Returns
    -------
    array, shape (H, W)
        Values at ``position + fraction``; the border is continued by its last pixel.
    """
    moved = image
    for axis, value in ((1, float(fraction[0])), (0, float(fraction[1]))):
        if value:
            moved = ndimage.correlate1d(moved, _cubic_taps(value), axis=axis, mode='nearest')
    return moved


def _cubic_taps(fraction):
    """Return the five weights, at -2 to 2, of cubic convolution at ``fraction``."""
    distance = np.abs(np.arange(-2, 3) - fraction)
    near = (1.5 * distance - 2.5) * distance ** 2 + 1.0
    far = ((-0.5 * distance + 2.5) * distance - 4.0) * distance + 2.0
    return np.where(distance < 1, near, np.where(distance < 2, far, 0.0))


def _features(frame):
    """Return the high-passed frame in robust deviations, clipped, 0 where masked.

    The first of the two has lonely outliers (targets, hot pixels) taken out, the second has not.
    """
    finite = np.isfinite(frame)
    image = np.array(frame, dtype=np.float32)
    if not finite.any():
        return np.zeros((2, *frame.shape), dtype=np.float32)
    if not finite.all():
        image[~finite] = np.median(image[finite])
    excess = image - _ring(image)
    outlying = (np.abs(excess) >= _CLIP * _deviation(excess[finite])).astype(np.float32)
    lonely = ndimage.uniform_filter(outlying, _HIGH_PASS_PX, mode='nearest') < _LONELY
    # the flanks of a target are below the clip
    lonely &= ndimage.uniform_filter(outlying, 5, mode='nearest') > 0.5 / 25
    kept = finite & ~lonely
    weight = ndimage.uniform_filter(kept.astype(np.float32), _HIGH_PASS_PX, mode='nearest')
    local = ndimage.uniform_filter(np.where(kept, image, np.float32(0)), _HIGH_PASS_PX,
                                   mode='nearest')
    image -= local / np.maximum(weight, np.float32(1e-3))
    image /= np.float32(_deviation(image[finite]))
    image[~finite] = 0.0
    np.clip(image, -_CLIP, _CLIP, out=image)
    return np.stack([np.where(kept, image, np.float32(0)), image])


def _ring(image):
    """Return the mean of the middle two of four pixels around each, which no target covers."""
    height, width = image.shape
    padded = np.pad(image, _RING_PX, mode='edge')
    around = [padded[row:row + height, column:column + width]
              for row, column in ((0, _RING_PX), (2 * _RING_PX, _RING_PX),
                                  (_RING_PX, 0), (_RING_PX, 2 * _RING_PX))]
    total = around[0] + around[1] + around[2] + around[3]
    low = np.minimum(np.minimum(around[0], around[1]), np.minimum(around[2], around[3]))
    high = np.maximum(np.maximum(around[0], around[1]), np.maximum(around[2], around[3]))
    return 0.5 * (total - low - high)


def _deviation(values):
    """Return a robust standard deviation that is not 0."""
    deviation = 1.4826 * float(np.median(np.abs(values)))
    return deviation or float(np.std(values)) or 1.0


def _match(fixed, moving, guess):
    """Find where ``moving`` shows ``fixed``; shift x, y in pixels and height of the peak.

    In a star field the lonely outliers are the scene: they are asked when the rest says nothing,
    and believed when they agree all over the image.
    """
    shift, peak, _ = _correlate(fixed[0], moving[0], guess)
    if peak < _CREDIBLE:
        bright_shift, bright_peak, tiles = _correlate(fixed[1], moving[1], guess)
        if bright_peak >= _CREDIBLE and tiles >= _LEAST_TILES:
            return bright_shift, bright_peak
    return shift, peak


def _correlate(fixed, moving, guess):
    """Correlate two images near a shift ``guess`` in whole pixels.

    Returns the shift x, y in pixels, the height of its peak over the deviation of the surface,
    and the number of tiles of the image that support it.
    """
    a, b = _overlap(fixed, moving, guess)
    rows, columns = a.shape
    taper = np.outer(_taper(rows), _taper(columns)).astype(np.float32)
    shape = fft.next_fast_len(rows, real=True), fft.next_fast_len(columns, real=True)
    spectrum = np.conj(fft.rfft2(a * taper, shape)) * fft.rfft2(b * taper, shape)
    spectrum *= _weights(shape) / np.maximum(np.abs(spectrum), 1e-12) ** _WHITENING
    surface = fft.irfft2(spectrum, shape)
    deviation = surface.std()
    if not deviation > 0:
        return np.zeros(2), 0.0, 0
    reach = max(1, int(_FARTHEST * min(fixed.shape)))
    nearby = [np.arange(-min(reach, (size - 1) // 2), min(reach, (size - 1) // 2) + 1)
              for size in shape]
    window = surface[np.ix_(*nearby)]
    highest = np.unravel_index(np.argmax(window), window.shape)
    row, column = (int(places[index]) for places, index in zip(nearby, highest, strict=True))
    around = np.array([-1, 0, 1])
    peak = surface[np.ix_((row + around) % shape[0], (column + around) % shape[1])]
    shift = np.array([column + _vertex(peak[1]), row + _vertex(peak[:, 1])])
    whole = np.array([column, row]) + guess
    return shift + guess, float(peak[1, 1] / deviation), _support(fixed, moving, whole)


def _overlap(fixed, moving, shift):
    """Return what both images show when the second is moved by ``shift`` x, y whole pixels."""
    x, y = (int(value) for value in shift)
    rows, columns = fixed.shape[0] - abs(y), fixed.shape[1] - abs(x)
    return (fixed[max(0, -y):max(0, -y) + rows, max(0, -x):max(0, -x) + columns],
            moving[max(0, y):max(0, y) + rows, max(0, x):max(0, x) + columns])


def _support(fixed, moving, shift):
    """Return how many of the image's 8 by 8 tiles agree on a shift beyond chance."""
    a, b = _overlap(fixed, moving, shift)
    rows, columns = (np.linspace(0, size, 9).astype(int)[:-1] for size in a.shape)
    product = a * b
    sums, squares = (np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
                     for values in (product, product * product))
    return int(np.count_nonzero(sums > _TILE_AGREES * np.sqrt(squares)))


def _weights(shape):
    """Return the low-pass in the frequency plane that gives the peak its width."""
    along_y = fft.fftfreq(shape[0])[:, None]
    along_x = fft.rfftfreq(shape[1])[None, :]
    square = (2 * np.pi * _PEAK_SIGMA_PX) ** 2 * (along_y ** 2 + along_x ** 2)
    return np.exp(-0.5 * square).astype(np.float32)


def _taper(length):
    """Return a window of ones with raised-cosine ends."""
    ramp = max(1, int(_TAPER * length))
    window = np.ones(length)
    window[:ramp] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / ramp)
    window[length - ramp:] = window[:ramp][::-1]
    return window


def _vertex(values):
    """Return where the curve through three values peaks, in pixels from the middle one."""
    left, middle, right = (float(value) for value in values)
    if min(left, right) > 0:
        # a Gaussian peak is a parabola in its logarithm
        left, middle, right = np.log([left, middle, right])
    bend = left - 2 * middle + right
    if not bend < 0:
        return 0.0
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
