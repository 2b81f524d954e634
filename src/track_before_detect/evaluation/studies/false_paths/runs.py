"""Single runs of the suite ``false-paths``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_before_detect.evaluation.engine.detectors import Options, stamps_of
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.convex.detector import ConvexDetector

# Frames that crops are taken of, px, and memory of a search, the same on every machine.
FRAME_PX = 256
MEMORY_GB = 0.7


class ThoroughDetector(ConvexDetector):
    """Refines so many of the best paths of noise that the best of all is among them.

    A threshold asks for crops whose best path stands out; here each crop is to count.
    """

    refined_in_noise = 12

    def false_paths(self, *_: Any) -> None:
        """Return nothing: what is made here is not needed to make it."""


def detector_for(options: Options) -> ThoroughDetector:
    """Return the detector whose paths are counted."""
    return ThoroughDetector(DetectorOptions.from_mapping(
        {**options, 'max_memory_gb': MEMORY_GB}))


def paths_of(detector: ThoroughDetector, n_frames: int) -> StateGraph:
    """Return the paths that are searched."""
    return detector.graph(stamps_of(n_frames), (FRAME_PX, FRAME_PX))


def study_of(detector: ThoroughDetector, n_frames: int) -> NoiseStudy:
    """Return how noise is searched."""
    return detector.noise_study(stamps_of(n_frames), (FRAME_PX, FRAME_PX))


def noise_maxima(item: Mapping[str, Any]) -> dict[str, list[float]]:
    """Search crops of noise.

    Parameters
    ----------
    item : mapping
        ``options``, ``n_frames``, ``side_px`` of the crops, ``n_crops`` and ``seed``, whole
        numbers.

    Returns
    -------
    dict
        ``maxima``: the largest statistic in each.
    """
    crop = (item['side_px'], item['side_px'])
    search = study_of(detector_for(item['options']), item['n_frames']).searcher(crop)
    seeds = np.random.SeedSequence(item['seed']).spawn(item['n_crops'])
    return {'maxima': [round(search(np.random.default_rng(seed)), 4) for seed in seeds]}

