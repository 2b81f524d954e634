"""White top-hat of each frame over a threshold, linked by trackpy."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.real.peers.trackpy_peer import (
    linked,
    MOST_FEATURES,
)
from track_before_detect.tracking.recording import FrameSequence

# Radius of the disc that no target fits into; deviations above the mean of the filtered frame.
RADIUS_PX, DEVIATIONS = 5, 5.0


def find_tracks(frames: FrameSequence) -> list[NDArray]:
    """Return positions (T, 2) of small bright regions, linked."""
    import pandas
    from skimage.measure import label, regionprops
    from skimage.morphology import disk, white_tophat

    rows = []
    for index in range(len(frames)):
        frame = white_tophat(np.asarray(frames[index], np.float32), disk(RADIUS_PX))
        regions = label(frame > frame.mean() + DEVIATIONS * frame.std())
        largest = sorted(regionprops(regions), key=lambda region: -region.area)
        rows += [(index, region.centroid[1], region.centroid[0])
                 for region in largest[:MOST_FEATURES]]
    return linked(pandas.DataFrame(rows, columns=['frame', 'x', 'y']), len(frames))
