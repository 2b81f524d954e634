"""Where the scene is in each frame: its shift found by correlation, and maps that start from it.

The camera moves, the scene with it: a point of the scene at position ``p`` of the reference frame
is at ``maps[t]`` of ``p`` in frame t. Without turns and zooms of the camera that is a shift, found
by correlation; Gauss-Newton steps find the rest.
"""

from collections.abc import Callable, Sequence
import dataclasses
from dataclasses import dataclass
import functools

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.parallel import map_in_threads
from track_before_detect.preprocess.per_frame import each_frame
from track_before_detect.preprocess.registration.correlation import CREDIBLE, features_of, match
from track_before_detect.preprocess.registration.gauss_newton import align, Template
from track_before_detect.preprocess.resampling import warped

_MOST_UNCERTAIN_PX = 0.5  # at a corner, of a map that is believed
_MOST_LEFT_PX = 0.5  # shift between two images brought together by a map
_LEAST_OVERLAP = 0.6  # share of either side still in common with the frame compared with


@dataclass(frozen=True)
class Registration:
    """Where the scene is in each frame.

    Attributes
    ----------
    maps : array, shape (T, 3, 3)
        Takes positions in the reference frame to where the scene is in each frame, see the
        module ``geometry``.
    quality : array, shape (T,)
        Height of the correlation peak over the standard deviation of the correlation surface;
        infinite for the reference frame.
    credible : array of bool, shape (T,)
        False where no peak stood out and the map was taken from neighbouring frames.
    refined : array of bool, shape (T,)
        False where the scene did not tell more than its shift, which was then added to the map
        of the frame before; true everywhere when no more than the shift was asked for.
    reference : int
        Number of the reference frame within the batch.
    """

    maps: NDArray[np.float64]
    quality: NDArray[np.float64]
    credible: NDArray[np.bool_]
    refined: NDArray[np.bool_]
    reference: int

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Shift x, y of the scene in each frame in pixels, shape (T, 2), where maps are shifts."""
        return self.maps[:, :2, 2]


def register(frames: NDArray, model: str = 'translation') -> Registration:
    """Find where the scene of the middle frame is in each frame.

    Each frame is high-passed and clipped, so that neither the shading of the lens nor a bright
    target decides, and correlated with the reference frame over what both show; further away,
    with the nearest frame already placed. A frame without a credible peak gets the map
    interpolated between its neighbours, or that of the nearest one.

    An affine map or a homography starts from the shift against the frame before and is believed
    when the images, brought together by it, agree as well as a shift has to, without a shift
    between them, and when the scene determines it all over the image.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values; those that are not finite are left out.
    model : str
        ``'translation'``, ``'affine'`` or ``'homography'``.

    Returns
    -------
    Registration
        Maps, their quality and the reference.
    """
    return register_features(each_frame(features_of, frames), model)


def register_features(features: Sequence[NDArray], model: str,
                      reference: int | None = None) -> Registration:
    """Find where the scene of the middle frame is in each frame, see :func:`register`.

    Parameters
    ----------
    features : sequence of array, shape (2, H, W)
        Of each frame, see ``features_of``.
    model : str
        ``'translation'``, ``'affine'`` or ``'homography'``.
    reference : int, optional
        The frame that others are compared with, that in the middle unless given.
    """
    n_frames = len(features)
    if reference is None:
        reference = _reference(features)
    maps = np.full((n_frames, 3, 3), np.nan)
    quality = np.zeros(n_frames)
    refined = np.ones(n_frames, dtype=bool)
    maps[reference] = np.eye(3)
    quality[reference] = np.inf
    place = _shifted if model == 'translation' else _aligned

    # Most frames are compared with the same one.
    @functools.cache
    def template(key: int, kind: int) -> Template:
        return Template(features[key][kind])

    def follow(order: range) -> None:
        key = last = reference
        for index in order:
            placed = place(features, maps, key, last, index, model, template)
            quality[index], refined[index] = placed.peak, placed.refined
            if placed.peak >= CREDIBLE:
                maps[index] = placed.matrix @ maps[placed.key]
                key, last = placed.key, index

    map_in_threads(follow, [range(reference + 1, n_frames), range(reference - 1, -1, -1)])
    credible = np.isfinite(maps[:, 0, 0])
    times = np.arange(n_frames)
    for row, column in np.ndindex(3, 3):
        maps[:, row, column] = np.interp(times, times[credible], maps[credible, row, column])
    return Registration(maps / maps[:, 2:, 2:], quality, credible, refined, reference)


def _reference(features: Sequence[NDArray]) -> int:
    """Return the frame with data nearest to the middle, or one beside it if it is spoiled."""
    middle = len(features) // 2
    numbers = sorted((t for t, feature in enumerate(features) if feature.any()),
                     key=lambda t: abs(t - middle))
    if len(numbers) < 3:
        return numbers[0] if numbers else middle
    first, second, third = numbers[:3]

    def matched(one: int, other: int) -> bool:
        found = match(features[one], features[other], np.zeros(2, dtype=int))
        return found.peak >= CREDIBLE

    spoiled = not (matched(first, second) or matched(first, third)) and matched(second, third)
    return second if spoiled else first


@dataclass(frozen=True)
class _Placed:
    """Map from the frame ``key`` to a new one, as good as its correlation peak is high."""

    matrix: NDArray[np.float64]
    peak: float
    key: int
    refined: bool = True


def _shifted(features: Sequence[NDArray], maps: NDArray, key: int, last: int, index: int,
             *_: object) -> _Placed:
    """Find the shift of a frame against the key frame, or against the last one placed."""
    height, width = features[index].shape[1:]
    guess = np.rint(maps[last, :2, 2] - maps[key, :2, 2]).astype(int)
    if np.any([width, height] - np.abs(guess) < _LEAST_OVERLAP * np.array([width, height])):
        key, guess = last, np.zeros(2, dtype=int)
    found = match(features[key], features[index], guess)
    if found.peak < CREDIBLE and key != last:
        found = match(features[last], features[index], np.zeros(2, dtype=int))
        key = last
    return _Placed(geometry.translations(found.shift[None])[0], found.peak, key)


def _aligned(features: Sequence[NDArray], maps: NDArray, key: int, last: int, index: int,
             model: str, template: Callable[[int, int], Template]) -> _Placed:
    """Find the map from the key frame, or from the last one placed, to a frame."""
    unmoved = np.zeros(2, dtype=int)
    found = match(features[last], features[index], unmoved)
    shift = geometry.translations(found.shift[None])[0]
    if found.peak < CREDIBLE:
        return _Placed(shift, found.peak, last)
    start = shift @ maps[last] @ geometry.inverse(maps[key])
    if key != last and _common_share(start, features[key].shape[1:]) < _LEAST_OVERLAP:
        key, start = last, shift
    alignment = align(template(key, found.kind), features[index][found.kind], start, model)
    if alignment.uncertainty_px <= _MOST_UNCERTAIN_PX:
        moved = np.stack([warped(image, alignment.matrix) for image in features[index]])
        after = match(features[key], np.nan_to_num(moved, copy=False), unmoved)
        if after.peak >= CREDIBLE and np.hypot(*after.shift) <= _MOST_LEFT_PX:
            return _Placed(alignment.matrix, after.peak, key)
    if np.allclose(start[:, :2], np.eye(3)[:, :2], atol=1e-9):
        # without any turn so far the key frame tells the shift, and does not drift
        return dataclasses.replace(_shifted(features, maps, key, last, index), refined=False)
    return _Placed(shift, found.peak, last, refined=False)


def _common_share(matrix: NDArray, shape: tuple[int, int]) -> float:
    """Return the share of an image's pixels that are still inside after a map."""
    rows, columns = (np.linspace(0, size - 1, 16) for size in shape)
    points = np.stack(np.meshgrid(columns, rows), axis=-1)
    map_position = geometry.apply(matrix, points)
    inside = (map_position >= 0) & (map_position <= (shape[1] - 1, shape[0] - 1))
    return float(np.mean(inside.all(axis=-1)))
