"""Registration by correlation: the shift of the scene between two images."""

from dataclasses import dataclass
import functools

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from track_before_detect.kernels.pictures.boxes import box_mean
from track_before_detect.preprocess.robust import median, median_deviation

_HIGH_PASS_PX = 31  # side of the box whose mean is taken off: shading of the lens stays put
_CLIP = 3.0  # of the robust deviation, so that no bright pixel decides alone
_RING_PX = 8  # from a pixel to the four whose middle says what lies around a target
_LONELY = 0.1  # share of clipped pixels in the box below which they are targets or hot pixels
_PEAK_SIGMA_PX = 1.0  # width given to the correlation peak, so that a Gaussian fits it
_WHITENING = 0.3  # power of the spectrum divided out: 0 plain correlation, 1 phase alone
_TAPER = 0.1  # share of each side faded out, so that the border does not correlate with itself
CREDIBLE = 8.0  # peak over the deviation of the surface; pure noise reaches 5.5
_TILE_AGREES = 2.5  # deviations of the correlation within a tile
_LEAST_TILES = 6  # of 64 that agree on a shift; one moving target may reach into four
_FARTHEST = 0.25  # share of the smaller side a frame may move from its neighbour


@dataclass(frozen=True)
class Match:
    """Where one image shows what another shows.

    Attributes
    ----------
    shift : array, shape (2,)
        x and y in pixels.
    peak : float
        Height of the correlation peak over the deviation of the surface; believed from
        ``CREDIBLE`` on.
    kind : int
        Which of the two features it was found in.
    """

    shift: NDArray[np.float64]
    peak: float
    kind: int


def features_of(frame: NDArray) -> NDArray[np.float32]:
    """Return what of a frame is compared: high-passed, in robust deviations, and clipped.

    Parameters
    ----------
    frame : array, shape (H, W)
        Real pixel values; those that are not finite count as masked.

    Returns
    -------
    array, shape (2, H, W)
        0 where masked. The first of the two has lonely outliers (targets, hot pixels) taken out,
        the second has not.
    """
    finite = np.isfinite(frame)
    image = np.array(frame, dtype=np.float32)
    if not finite.any():
        return np.zeros((2, *frame.shape), dtype=np.float32)
    if not finite.all():
        image[~finite] = median(image[finite])
    excess = image - _ring(image)
    outlying = (np.abs(excess) >= _CLIP * _deviation(excess[finite])).astype(np.float32)
    lonely = _box_mean(outlying, _HIGH_PASS_PX) < _LONELY
    # the flanks of a target are below the clip
    lonely &= _box_mean(outlying, 5) > 0.5 / 25
    kept = finite & ~lonely
    weight = _box_mean(kept.astype(np.float32), _HIGH_PASS_PX)
    local = _box_mean(np.where(kept, image, np.float32(0)), _HIGH_PASS_PX)
    image -= local / np.maximum(weight, np.float32(1e-3))
    image /= np.float32(_deviation(image[finite]))
    image[~finite] = 0.0
    np.clip(image, -_CLIP, _CLIP, out=image)
    return np.stack([np.where(kept, image, np.float32(0)), image])


def match(fixed: NDArray, moving: NDArray, guess: NDArray) -> Match:
    """Find where one image shows another.

    In a star field the lonely outliers are the scene: they are asked when the rest says nothing,
    and believed when they agree all over the image.

    Parameters
    ----------
    fixed, moving : array, shape (2, H, W)
        Features of both.
    guess : array of int, shape (2,)
        Shift x, y in whole pixels that is looked near.
    """
    shift, peak = _correlate(fixed[0], moving[0], guess)
    if peak < CREDIBLE:
        bright_shift, bright_peak = _correlate(fixed[1], moving[1], guess)
        if (bright_peak >= CREDIBLE
                and _support(fixed[1], moving[1], np.rint(bright_shift)) >= _LEAST_TILES):
            return Match(bright_shift, bright_peak, 1)
    return Match(shift, peak, 0)


def _ring(image: NDArray[np.float32]) -> NDArray[np.float32]:
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


def _box_mean(image: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    mean = np.empty_like(image)
    box_mean(image, side, mean)
    return mean


def _deviation(values: NDArray) -> float:
    """Return a robust standard deviation that is not 0."""
    return median_deviation(values) or float(np.std(values)) or 1.0


def _correlate(fixed: NDArray, moving: NDArray,
               guess: NDArray) -> tuple[NDArray[np.float64], float]:
    """Correlate two images near a shift ``guess`` in whole pixels.

    Returns the shift x, y in pixels, and the height of its peak over the deviation of the surface.
    """
    a, b = _overlap(fixed, moving, guess)
    rows, columns = a.shape
    taper = _taper(rows, columns)
    shape = fft.next_fast_len(rows, real=True), fft.next_fast_len(columns, real=True)
    spectrum = np.conj(fft.rfft2(a * taper, shape)) * fft.rfft2(b * taper, shape)
    spectrum *= _low_pass(shape) / np.maximum(np.abs(spectrum), 1e-12) ** _WHITENING
    surface = fft.irfft2(spectrum, shape)
    deviation = surface.std()
    if not deviation > 0:
        return np.zeros(2), 0.0
    reach = max(1, int(_FARTHEST * min(fixed.shape)))
    nearby = [np.arange(-min(reach, (size - 1) // 2), min(reach, (size - 1) // 2) + 1)
              for size in shape]
    window = surface[np.ix_(*nearby)]
    highest = np.unravel_index(np.argmax(window), window.shape)
    row, column = (int(places[index]) for places, index in zip(nearby, highest, strict=True))
    around = np.array([-1, 0, 1])
    peak = surface[np.ix_((row + around) % shape[0], (column + around) % shape[1])]
    shift = np.array([column + _vertex(peak[1]), row + _vertex(peak[:, 1])])
    return shift + guess, float(peak[1, 1] / deviation)


def _overlap(fixed: NDArray, moving: NDArray, shift: NDArray) -> tuple[NDArray, NDArray]:
    """Return what both images show when the second is moved by ``shift`` x, y whole pixels."""
    x, y = (int(value) for value in shift)
    rows, columns = fixed.shape[0] - abs(y), fixed.shape[1] - abs(x)
    return (fixed[max(0, -y):max(0, -y) + rows, max(0, -x):max(0, -x) + columns],
            moving[max(0, y):max(0, y) + rows, max(0, x):max(0, x) + columns])


def _support(fixed: NDArray, moving: NDArray, shift: NDArray) -> int:
    """Return how many of the image's 8 by 8 tiles agree on a shift beyond chance."""
    a, b = _overlap(fixed, moving, shift)
    rows, columns = (np.linspace(0, size, 9).astype(int)[:-1] for size in a.shape)
    product = a * b
    sums, squares = (np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
                     for values in (product, product * product))
    return int(np.count_nonzero(sums > _TILE_AGREES * np.sqrt(squares)))


# Most images are compared as a whole, and all of a batch are of one size.
@functools.lru_cache(maxsize=2)
def _low_pass(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the low-pass in the frequency plane that gives the peak its width."""
    along_y, along_x = (np.exp(-0.5 * (2 * np.pi * _PEAK_SIGMA_PX * frequency) ** 2)
                        for frequency in (fft.fftfreq(shape[0]), fft.rfftfreq(shape[1])))
    return np.outer(along_y, along_x).astype(np.float32)


@functools.lru_cache(maxsize=2)
def _taper(*shape: int) -> NDArray[np.float32]:
    """Return a window of ones with raised-cosine ends along each axis."""
    return np.outer(*map(_tapered_line, shape))


def _tapered_line(length: int) -> NDArray[np.float32]:
    ramp = max(1, int(_TAPER * length))
    window = np.ones(length, np.float32)
    window[:ramp] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(ramp) + 0.5) / ramp)
    window[length - ramp:] = window[:ramp][::-1]
    return window


def _vertex(values: NDArray) -> float:
    """Return where the curve through three values peaks, in pixels from the middle one."""
    left, middle, right = (float(value) for value in values)
    if min(left, right) > 0:
        # a Gaussian peak is a parabola in its logarithm
        left, middle, right = np.log([left, middle, right])
    bend = left - 2 * middle + right
    if not bend < 0:
        return 0.0
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
