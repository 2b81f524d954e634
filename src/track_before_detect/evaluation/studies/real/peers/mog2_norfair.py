"""OpenCV's background subtraction MOG2, its regions tracked by norfair."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.real.peers.trackpy_peer import MOST_FEATURES
from track_before_detect.tracking.recording import FrameSequence

# How far a region moves in a frame; pixels of the smallest region.
DISTANCE_PX, LEAST_PIXELS = 10, 2


def find_tracks(frames: FrameSequence) -> list[NDArray]:
    """Return positions (T, 2) of what moves before the background."""
    import cv2
    from norfair import Detection, Tracker

    background = cv2.createBackgroundSubtractorMOG2(detectShadows=False)
    tracker = Tracker('mean_euclidean', DISTANCE_PX)
    tracks: dict[int, NDArray] = {}
    for index in range(len(frames)):
        # MOG2 takes 8 bits or float; its variances are in the units of 8 bits.
        moving = background.apply(np.asarray(frames[index], np.float32))
        _, _, stats, centres = cv2.connectedComponentsWithStats(moving)
        kept = np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= LEAST_PIXELS) + 1
        # The largest; noise has thousands.
        kept = kept[np.argsort(-stats[kept, cv2.CC_STAT_AREA], kind='stable')[:MOST_FEATURES]]
        for tracked in tracker.update([Detection(centres[region][None]) for region in kept]):
            positions = tracks.setdefault(tracked.id, np.full((len(frames), 2), np.nan))
            positions[index] = tracked.estimate[0]
    return list(tracks.values())
