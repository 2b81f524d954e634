"""How much of each track is one target, and how much of each target is one track."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.matching import closest_pairs, Paths


class TrackQuality(NamedTuple):
    """Purity of tracks and completeness of targets.

    In every frame tracks and targets within the limit are paired, as many as possible and then as
    close as possible.

    Attributes
    ----------
    purity : array, shape (N,)
        Share of the frames of each track in which it is paired with the target it is paired with
        most often; NaN for a track without frames.
    completeness : array, shape (M,)
        Share of the frames of each target in which it is paired with the track it is paired with
        most often.
    coverage : array, shape (M,)
        Share of the frames of each target in which it is paired with any track.
    n_tracks : array of int, shape (M,)
        Tracks that each target was ever paired with.
    """

    purity: NDArray[np.float64]
    completeness: NDArray[np.float64]
    coverage: NDArray[np.float64]
    n_tracks: NDArray[np.int64]


def track_quality(found: Paths, targets: Paths, limit_px: float) -> TrackQuality:
    """Measure purity and completeness; ``limit_px`` is the largest distance of a pair."""
    if not limit_px > 0:
        raise ParameterError(f'limit_px must be above 0, got {limit_px:g}')
    counts = np.zeros((len(found), len(targets)), np.int64)
    tracks, truths = np.asarray(found, float), np.asarray(targets, float)
    if counts.size:
        for frame in range(truths.shape[1]):
            counts[_paired(tracks[:, frame], truths[:, frame], limit_px)] += 1
    return TrackQuality(
        _share(counts.max(axis=1, initial=0), tracks),
        _share(counts.max(axis=0, initial=0), truths),
        _share(counts.sum(axis=0), truths), (counts > 0).sum(axis=0))


def _paired(tracks: NDArray, truths: NDArray, limit_px: float) -> tuple[NDArray, NDArray]:
    """Return the pairs of one frame as two arrays of indices."""
    distances = np.linalg.norm(tracks[:, None] - truths[None], axis=2)
    near = distances <= limit_px
    # Those that are in no pair would only make the assignment larger.
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    some = np.ix_(rows, columns)
    pairs = closest_pairs(distances[some], near[some], limit_px)
    return rows[pairs[:, 0]], columns[pairs[:, 1]]


def _share(part: NDArray, paths: NDArray) -> NDArray[np.float64]:
    """Return the share of the frames in which each is present."""
    whole = (np.isfinite(paths).all(axis=2).sum(axis=1) if len(paths) else np.zeros(0, np.int64))
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)
