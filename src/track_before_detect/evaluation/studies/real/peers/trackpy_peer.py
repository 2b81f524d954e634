"""trackpy, as its walkthrough has it: locate, link, drop what is short."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.tracking.recording import FrameSequence

# Size of a feature, odd; how far it moves in a frame; frames it may be missing; shortest track.
DIAMETER_PX, SEARCH_RANGE_PX, MEMORY_FRAMES, LEAST_FRAMES = 5, 5, 3, 5
# Most features of a frame that are linked, the strongest first: noise has thousands.
MOST_FEATURES = 100
# Where too many features are near each other to be linked, the range becomes less, down to this.
LEAST_RANGE_PX = 1
# The walkthrough has the user read the least mass off a histogram; here it is this many deviations
# above the masses of what noise and scene make of the first frame.
MASS_DEVIATIONS = 10.0


def find_tracks(frames: FrameSequence) -> list[NDArray]:
    """Return positions (T, 2) of bright features, linked."""
    import pandas
    import trackpy

    trackpy.quiet()
    least = 0.0
    found = []
    for index in range(len(frames)):
        features = trackpy.locate(
            np.asarray(frames[index], float), DIAMETER_PX, minmass=least,
            topn=MOST_FEATURES if index else None)
        if index == 0 and len(features):
            middle = features['mass'].median()
            least = float(middle + MASS_DEVIATIONS * 1.4826
                          * (features['mass'] - middle).abs().median())
            features = features[features['mass'] > least].nlargest(MOST_FEATURES, 'mass')
        found.append(features.assign(frame=index)[['frame', 'x', 'y']])
    return linked(pandas.concat(found), len(frames))


def linked(features: Any, n_frames: int) -> list[NDArray]:
    """Return the tracks in a table of frame, x and y, linked by trackpy."""
    import trackpy

    trackpy.quiet()
    if not len(features):
        return []
    table = trackpy.filter_stubs(
        trackpy.link(features, SEARCH_RANGE_PX, memory=MEMORY_FRAMES,
                     adaptive_stop=LEAST_RANGE_PX), LEAST_FRAMES)
    tracks = []
    for _, rows in table.groupby('particle'):
        positions = np.full((n_frames, 2), np.nan)
        positions[rows['frame']] = rows[['x', 'y']]
        tracks.append(positions)
    return tracks
