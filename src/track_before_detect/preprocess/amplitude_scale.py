"""Maps of magnitude, power or decibels: recognised, and brought to nearly Gaussian noise.

The power of complex noise is exponential, whatever its level. Of three such powers of one pixel
the first two share what they have in ratios that are uniform, and so is the square of what the
third leaves of the sum; both ratios are independent of each other and of the level. A map is what
makes them so: nothing has to be known of the level of each pixel.
"""

import numpy as np
from numpy.typing import NDArray

POWERS = {'magnitude': 2.0, 'power': 1.0}
_NEARLY_GAUSSIAN = 0.2654  # exponent that brings an exponential quantity closest to a Gaussian
_NEPERS_PER_DECIBEL = np.log(10.0) / 10.0
_LEAST_TRIPLES = 5000  # with fewer, Gaussian noise of 5 may pass for decibels
_MOST_TRIPLES = 50_000
_ALWAYS = 2.0  # Kolmogorov's statistic of a true map stays below this in all but 1 of 1500
_OTHERS = 0.02  # share of pixels that may hold targets and clutter
_FARTHEST_LEVEL = 60.0  # nepers of power from the median beyond which a map is none of decibels


def recognised_scale(frames: NDArray) -> str:
    """Return which scale makes the noise of a batch that of complex maps.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values, NaN where masked.

    Returns
    -------
    str
        ``'magnitude'``, ``'power'`` or ``'decibels'``, or ``'linear'`` where none of them fits.
    """
    third = len(frames) // 3
    if not third:
        return 'linear'
    triples = np.moveaxis(frames[:3 * third].reshape(3, -1), 0, -1)
    triples = triples[np.isfinite(triples).all(axis=1)]
    triples = triples[::-(-len(triples) // _MOST_TRIPLES) or 1].astype(np.float64)
    if len(triples) < _LEAST_TRIPLES:
        return 'linear'
    tolerance = _OTHERS + _ALWAYS / np.sqrt(len(triples))
    misfits: dict[str, float] = {}
    # not even one pixel of a magnitude is below zero
    if triples.min() >= 0 and triples.max() > 0:
        scaled = triples / triples.max()
        misfits.update((name, _misfit(scaled ** power)) for name, power in POWERS.items())
    if np.array_equal(triples, np.rint(triples)):
        # rounding to whole decibels made equal what is not
        triples += np.random.default_rng(0).uniform(-0.5, 0.5, triples.shape)
    level = _NEPERS_PER_DECIBEL * (triples - np.median(triples))
    if np.max(np.abs(level)) < _FARTHEST_LEVEL:
        misfits['decibels'] = _misfit(np.exp(level))
    best = min(misfits, key=lambda name: misfits[name], default='linear')
    return best if misfits and misfits[best] < tolerance else 'linear'


def nearly_gaussian(frames: NDArray, scale: str) -> NDArray:
    """Return maps of a known scale as values whose noise is nearly Gaussian.

    A power of the power: the noise of 0.2654 has the deviation 0.30 of its mean and no heavy tail.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values, NaN where masked; of magnitudes and powers none below 0.
    scale : str
        ``'magnitude'``, ``'power'`` or ``'decibels'``.
    """
    if scale == 'decibels':
        return np.exp(frames * frames.dtype.type(_NEPERS_PER_DECIBEL * _NEARLY_GAUSSIAN))
    return frames ** frames.dtype.type(POWERS[scale] * _NEARLY_GAUSSIAN)


def _misfit(powers: NDArray[np.float64]) -> float:
    """Return how far triples of powers, shape (N, 3), are from exponential: Kolmogorov's D."""
    ordered = np.sort(powers, axis=1)
    # the steps from one to the next are exponential again, and tell small values apart
    steps = np.diff(ordered, axis=1, prepend=0.0) * (3.0, 2.0, 1.0)
    return max(_distance(powers), _distance(steps))


def _distance(powers: NDArray[np.float64]) -> float:
    """Return the larger distance of the two ratios of triples from a uniform distribution."""
    pair = powers[:, 0] + powers[:, 2]
    known = pair > 0
    if np.mean(known) < 1 - _OTHERS:
        return 1.0
    pair, powers = pair[known], powers[known]
    ratios = np.sort([powers[:, 0] / pair, (pair / (pair + powers[:, 1])) ** 2], axis=1)
    ranks = (np.arange(len(pair)) + 0.5) / len(pair)
    return float(np.max(np.abs(ratios - ranks)))
