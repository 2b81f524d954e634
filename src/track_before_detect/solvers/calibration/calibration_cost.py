"""How long a search of noise takes on one core, by formula.

Where a search takes long fewer crops of noise are searched for a threshold. A formula, not a
measurement, so that a calibration is the same on every machine; right within about a third on the
one that the constants were measured on (float32, crops of 32 to 128 pixels, 1 to 50 frames).
"""

import numpy as np

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph

# Of the score of a place in a frame and each component of the PSF, the noise included; of complex
# ones so many times that.
SECONDS_PER_SCORE = 7.7e-9
COMPLEX_SCORES = 3.0
# Of a place on a streak around a place.
SECONDS_PER_STREAK_PLACE = 1.4e-9
# Of the score of a place that sensors see through maps: of a pixel of the stamp, which is made
# once for all frames of a sensor, and of the same pixel in each of them.
SECONDS_PER_MAPPED_PIXEL = 6e-9
SECONDS_PER_PIXEL_SEEN = 1.2e-9
# Of adding a score to a state, and of the best of the turns to a state.
SECONDS_PER_SUM = 8e-11
SECONDS_PER_TURN = 2e-9
# Passes over all paths that a search takes of targets that enter and leave, and of those of
# constant amplitude.
PARTIAL_PASSES = 2.0
CONSTANT_PARTIAL_PASSES = 7.4
# Of refining a path: of the families of motions, and for each frame; of that, of each component
# and moment of the exposure, and of each of their pixels.
SECONDS_PER_PATH = 3e-4
SECONDS_PER_FRAME = 4e-5
SECONDS_PER_STAMP = 5e-5
SECONDS_PER_STAMP_PIXEL = 2.7e-7


def search_seconds(graph: StateGraph, measurement: MeasurementModel, grid: tuple[int, int],
                   model: AmplitudeModel, partial: bool, n_refined: int) -> float:
    """Return the CPU time of one search of noise.

    Parameters
    ----------
    graph : StateGraph
        The paths.
    measurement : MeasurementModel
        How frames see targets.
    grid : tuple of int
        Positions (Y, X).
    model : AmplitudeModel
        Of the amplitudes.
    partial : bool
        Whether targets may enter and leave.
    n_refined : int
        Paths whose positions are refined.
    """
    passes = 1.0
    if partial:
        passes = CONSTANT_PARTIAL_PASSES if model.is_constant else PARTIAL_PASSES
    table = passes * graph.n_velocities * (
        graph.n_frames * SECONDS_PER_SUM + (graph.n_segments - 1) * SECONDS_PER_TURN)
    work = measurement.search_work(graph, model.is_complex)
    scoring = (
        (COMPLEX_SCORES if model.is_complex else 1.0) * SECONDS_PER_SCORE * work.filtered
        + SECONDS_PER_STREAK_PLACE * work.streak_places
        + SECONDS_PER_MAPPED_PIXEL * work.stamp_pixels + SECONDS_PER_PIXEL_SEEN * work.seen_pixels)
    looking = (SECONDS_PER_FRAME * graph.n_frames + SECONDS_PER_STAMP * work.stamps
               + SECONDS_PER_STAMP_PIXEL * work.pixels)
    return (float(np.prod(grid)) * (scoring + table)
            + n_refined * (SECONDS_PER_PATH + looking))
