"""OpenCV's background subtraction MOG2, its regions tracked by norfair."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.real.peers.trackpy_peer import MOST_FEATURES
from track_before_detect.tracking.recording import FrameSequence

# How far a region moves in a frame; pixels of the smallest region.
DISTANCE_PX, LEAST_PIXELS = 10, 2


class Distances:
    """Distances of detections and what is tracked, as norfair's own of one point.

    It asks for each pair anew where both are, which was nine tenths of its time; nothing moves
    while they are compared.
    """

    def __init__(self) -> None:
        self._at: dict[int, list[float]] = {}

    def between(self, detection: Any, tracked: Any) -> float:
        """Return the distance in pixels."""
        seen = self._at.get(id(detection)) or self._place(detection, detection.points)
        expected = self._at.get(id(tracked)) or self._place(tracked, tracked.estimate)
        return math.dist(seen, expected)

    def forget(self) -> None:
        """Forget where they were, before the next frame."""
        self._at.clear()

    def _place(self, one: Any, points: NDArray) -> list[float]:
        at: list[float] = points[0].tolist()
        self._at[id(one)] = at
        return at


def find_tracks(frames: FrameSequence) -> list[NDArray]:
    """Return positions (T, 2) of what moves before the background."""
    import cv2
    from norfair import Detection, Tracker

    background = cv2.createBackgroundSubtractorMOG2(detectShadows=False)
    distances = Distances()
    tracker = Tracker(distances.between, DISTANCE_PX)
    tracks: dict[int, NDArray] = {}
    for index in range(len(frames)):
        # MOG2 takes 8 bits or float; its variances are in the units of 8 bits.
        moving = background.apply(np.asarray(frames[index], np.float32))
        _, _, stats, centres = cv2.connectedComponentsWithStats(moving)
        kept = np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= LEAST_PIXELS) + 1
        # The largest; noise has thousands.
        kept = kept[np.argsort(-stats[kept, cv2.CC_STAT_AREA], kind='stable')[:MOST_FEATURES]]
        distances.forget()
        for tracked in tracker.update([Detection(centres[region][None]) for region in kept]):
            positions = tracks.setdefault(tracked.id, np.full((len(frames), 2), np.nan))
            positions[index] = tracked.estimate[0]
    return list(tracks.values())
