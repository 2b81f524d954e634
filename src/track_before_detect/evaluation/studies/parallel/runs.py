"""Single runs of the suite ``parallel`` (Guo et al. 2018, Section 4)."""

from collections.abc import Mapping, Sequence
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.detectors import stamps_of
from track_before_detect.evaluation.metrics.paper_metrics import track_errors
from track_before_detect.evaluation.studies.parallel import scenes
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.cancellation.mt_dp import MtDpDetector
from track_before_detect.solvers.cancellation.pc_dp import PcDpDetector
from track_before_detect.solvers.cancellation.target_cancellation import (
    Search,
    TargetSearch,
    Track,
)
from track_before_detect.solvers.pixel_statistics import exclusion_levels, measure

METHODS: dict[str, type[MtDpDetector]] = {'mt_dp': MtDpDetector, 'pc_dp': PcDpDetector}

Item = Mapping[str, Any]


def six_targets(item: Item) -> dict[str, dict[str, Any]]:
    """Search the scene of six targets by both methods.

    Parameters
    ----------
    item : mapping
        ``snr_db``, ``seed`` and ``thresholds`` by method.

    Returns
    -------
    dict
        By method, of each target: whether it was ``detected`` and its ``squared_error`` in
        squared cells (None otherwise); ``n_tracks``; of each search, one for each direction: the
        targets it ``found`` and the ``candidates`` it looked at.
    """
    scene = scenes.six_targets(item['snr_db'], np.random.default_rng(item['seed']))
    results = {}
    for name in METHODS:
        tracks, searches = _search(name, scene.frames, item['thresholds'][name])
        results[name] = {
            **outcome(tracks, scene.cells),
            'found': [len(search.tracks) for search in searches],
            'candidates': [search.n_candidates for search in searches]}
    return results


def outcome(tracks: Sequence[Track], cells: NDArray) -> dict[str, Any]:
    """Compare tracks with the cells (N, T, 2) of targets."""
    errors = track_errors([track.pixels for track in tracks], cells)
    return {
        'detected': errors.detected.tolist(),
        'squared_error': [float(error) if hit else None for error, hit in
                          zip(errors.squared_errors, errors.detected, strict=True)],
        'n_tracks': len(tracks)}


def noise(item: Item) -> dict[str, bool]:
    """Return by method whether a batch of noise yields a track; item without ``snr_db``."""
    frames = noise_frames(np.random.default_rng(item['seed']),
                          (scenes.N_FRAMES, *scenes.SHAPE), True)
    return {name: bool(_search(name, frames, item['thresholds'][name])[0]) for name in METHODS}


@functools.lru_cache(maxsize=4)
def _detector(name: str) -> MtDpDetector:
    return METHODS[name](DetectorOptions.from_mapping(
        {'detector': name, **scenes.OPTIONS, 'threshold': 1.0}))


def _search(name: str, frames: NDArray, threshold: float,
            ) -> tuple[Sequence[Track], Sequence[Search]]:
    """Return the tracks of a method and its searches, one for each direction."""
    detector = _detector(name)
    search = TargetSearch(measure(frames, detector.psf), exclusion_levels(detector.psf),
                          detector.merit)
    bound = detector.merit.bound(threshold, len(frames))
    # On one thread: other runs have the other cores.
    searches = search.run_parallel(
        detector.transition_sets(stamps_of(len(frames))), bound, 1)
    return (searches[0].tracks if len(searches) == 1 else search.fuse(searches, bound)), searches
