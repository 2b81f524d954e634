"""Frames that hold no picture of the scene: blank, saturated, garbage, or after a cut."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from track_before_detect.preprocess.per_frame import each_frame, shown
from track_before_detect.preprocess.registration.correlation import CREDIBLE, features_of, match
from track_before_detect.preprocess.robust import median_deviation, robust_deviation

_FAR = 5.0  # times the usual contrast, or one over that: another picture, or none
_FAR_DEVIATIONS = 8.0  # of the logarithm of the contrast of the frames, beside that
_SATURATED = 0.5  # share of the pixels at the largest value, beyond the usual one
_MOST_PIXELS = 40_000  # of a frame that are compared
_LAGS = (1, 2, 3)  # frames on, with which each is compared
_SIGNIFICANT = 5.0  # deviations by which the usual likeness stands out of chance
_LEAST_LIKENESS = 0.25  # of the usual one
_ROLLS = 16  # shifts that say what likeness chance makes


def frame_faults(frames: NDArray) -> dict[str, NDArray[np.bool_]]:
    """Find the frames that are no pictures.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values, NaN where masked.

    Returns
    -------
    dict of str to array of bool, shape (T,)
        ``'blank'``: a single value, or far less contrast than usual. ``'saturated'``: half of the
        pixels more than usual are at the largest value of the batch. ``'garbage'``: far more
        contrast than usual, and nothing of what the nearest picture shows.
    """
    has_data = shown(frames)
    single, saturated, faint, garbage = np.zeros((4, len(frames)), dtype=bool)
    share, contrast, low, high = np.zeros((4, len(frames)))
    numbers = np.flatnonzero(has_data)
    if len(numbers):
        frames_with_data = [frames[t] for t in numbers]
        low[numbers], high[numbers], contrast[numbers] = np.transpose(each_frame(
            lambda frame: (np.nanmin(frame), np.nanmax(frame), robust_deviation(_part(frame))),
            frames_with_data))
        single[numbers] = (low == high)[numbers]
        highest = high[numbers].max()
        share[numbers] = each_frame(lambda frame: np.mean(frame == highest), frames_with_data)
        saturated = share > _SATURATED + np.median(share[numbers])
        faint |= single & ~saturated
    pictures = has_data & ~single & ~saturated
    usual = float(np.median(contrast[pictures])) if pictures.any() else 0.0
    if usual > 0:
        far = np.log(np.maximum(contrast, 1e-9 * usual) / usual)
        limit = max(np.log(_FAR), _FAR_DEVIATIONS * median_deviation(far[pictures]))
        faint |= pictures & (far < -limit)
        ordinary = np.flatnonzero(pictures & (np.abs(far) <= limit))
        for t in np.flatnonzero(pictures & (far > limit)):
            nearest = ordinary[np.argmin(np.abs(ordinary - t))]
            garbage[t] = not _found_again(frames[t], frames[nearest])
    return {'blank': faint, 'saturated': saturated, 'garbage': garbage}


def other_scenes(frames: NDArray) -> NDArray[np.bool_] | None:
    """Return the frames that do not show the scene of most others.

    Frames are alike when their high-passed pixels correlate at least a quarter as much as those
    of successive frames usually do, or when a shift of one is found in the other.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values, registered if the camera moves, NaN where masked.

    Returns
    -------
    array of bool, shape (T,), or None
        None where the frames have nothing in common that stands out of their noise.
    """
    numbers = [t for t in range(len(frames)) if np.isfinite(frames[t]).any()
               # one that repeats the frame before says nothing of how alike others are
               and not (t and np.array_equal(frames[t], frames[t - 1]))]
    if len(numbers) < _LAGS[-1]:
        return None
    features = [features_of(_part(frames[t]))[0] for t in numbers]
    vectors = np.array([feature.ravel() for feature in features])
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    likeness = vectors @ vectors.T
    chance = _chance(features[len(features) // 2])
    linked = np.zeros(likeness.shape, dtype=bool)
    compared = False
    for lag in _LAGS[:len(numbers) - 1]:
        values = np.diagonal(likeness, lag)
        usual = np.median(values)
        if usual > _SIGNIFICANT * chance:
            compared = True
            linked[np.arange(len(values)), np.arange(lag, len(numbers))] = (
                values > _LEAST_LIKENESS * usual)
    if not compared:
        return None
    _, scene = csgraph.connected_components(linked, directed=False)
    # of equally many the later ones, of which no earlier batch has seen more
    of_most = scene == scene.max() - np.argmax(np.bincount(scene)[::-1])
    for label in np.unique(scene[~of_most]):
        own, most = np.flatnonzero(scene == label), np.flatnonzero(of_most)
        near = np.abs(own[:, None] - most[None, :])
        one, other = np.unravel_index(np.argmin(near), near.shape)
        if _found_again(frames[numbers[own[one]]], frames[numbers[most[other]]]):
            of_most[own] = True
    odd = np.zeros(len(frames), dtype=bool)
    odd[np.array(numbers)[~of_most]] = True
    return odd


def at_an_end(odd: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the odd frames lie before the first or after the last of the others."""
    kept = np.flatnonzero(~odd)
    order = np.arange(len(odd))
    return odd & ((order < kept[0]) | (order > kept[-1])) if len(kept) else odd


def _part(frame: NDArray) -> NDArray:
    """Return as many pixels of a frame as tell enough, on a coarser grid."""
    step = max(1, int(np.ceil(np.sqrt(frame.size / _MOST_PIXELS))))
    return frame[::step, ::step]


def _chance(feature: NDArray) -> float:
    """Return the likeness that a picture has with itself when shifted far."""
    height, width = feature.shape
    shifts = [((k * height) // _ROLLS, (k * 7 * width) // _ROLLS % width)
              for k in range(1, _ROLLS)]
    products = [np.vdot(feature, np.roll(feature, shift, axis=(0, 1))) for shift in shifts]
    return float(np.sqrt(np.mean(np.square(products))) / max(np.vdot(feature, feature), 1e-9))


def _found_again(frame: NDArray, other: NDArray) -> bool:
    """Return whether one frame shows what another shows, shifted or not."""
    found = match(features_of(frame), features_of(other), np.zeros(2, dtype=int))
    return found.peak >= CREDIBLE
