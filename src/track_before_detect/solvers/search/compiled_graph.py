"""What the compiled loops of the search need to know of a state graph."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.rows import ABSENT
from track_before_detect.kernels.search import viterbi, viterbi_backtrack
from track_before_detect.kernels.search.viterbi import BLOCKS, VECTOR
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence

_NOWHERE = np.empty((0, 0), np.int64)


def layout_of(graph: StateGraph, grid_shape: tuple[int, int], spare: int = 0) -> viterbi.Layout:
    """Return where the positions of a grid (Y, X) lie, ``spare`` more than needed between rows."""
    n_y, n_x = grid_shape
    pad = int(max(np.abs(graph.moves).max(), np.abs(graph.end_moves).max())) + spare
    stride = VECTOR * -(-(n_x + pad) // VECTOR)
    lanes = VECTOR * -(-n_x // VECTOR)
    return viterbi.Layout(
        n_y, n_x, graph.n_velocities, stride, lanes, block=VECTOR * -(-lanes // (VECTOR * BLOCKS)),
        pad=pad, guard=VECTOR * -(-(stride + 2 * pad) // VECTOR))


def motion_of(graph: StateGraph, kinds: NDArray, presence: Presence | None,
              ) -> viterbi_backtrack.Motion:
    """Return all segments of a graph; ``kinds`` and ``presence`` as of ``ViterbiTable``."""
    reach = int(graph.reach)
    columns, rows = graph.grid.T
    velocity_at = np.full((rows.max() + 1 + 2 * reach, columns.max() + 1 + 2 * reach),
                          graph.n_velocities)
    velocity_at[rows + reach, columns + reach] = np.arange(graph.n_velocities)
    entry, leaving = (presence.entry, presence.leaving) if presence else (-ABSENT, -ABSENT)
    return viterbi_backtrack.Motion(
        np.asarray(graph.knots, np.int64), np.asarray(graph.moves, np.int64),
        np.asarray(graph.end_moves, np.int64), np.asarray(kinds, np.int64),
        viterbi.Turns((rows + reach) * velocity_at.shape[1] + columns + reach,
                      velocity_at.ravel(), velocity_at.shape[1], reach,
                      np.float32(graph.turn_cost)),
        np.float32(entry), np.float32(leaving))


def segment_of(graph: StateGraph, j: int, layout: viterbi.Layout,
               motion: viterbi_backtrack.Motion) -> viterbi.Segment:
    """Return one segment of a graph, whose states lie nowhere yet."""
    first, last = motion.knots[j], motion.knots[j + 1]
    x, y = motion.moves[first:last].transpose(2, 1, 0)
    frames = (np.arange(first, last) + graph.n_frames * motion.kinds[:, None]) * layout.n_y
    return viterbi.Segment(
        offsets=np.ascontiguousarray((frames + y) * layout.stride + x),
        rows=np.ascontiguousarray(y), first_y=np.maximum(0, -y.min(axis=1)),
        last_y=layout.n_y - np.maximum(0, y.max(axis=1)),
        arrival=motion.end_moves[j - 1] if j else np.empty((0, 2), np.int64),
        places=_NOWHERE, places_before=_NOWHERE, turns=motion.turns)


def placed(segment: viterbi.Segment, j: int, places: NDArray[np.int64]) -> viterbi.Segment:
    """Return segment j with its states where ``places`` (J - 1, Y, V) say."""
    return segment._replace(places=places[j] if j < len(places) else _NOWHERE,
                            places_before=places[j - 1] if j else _NOWHERE)


def end_costs_of(presence: Presence | None, last: bool) -> viterbi.EndCosts | None:
    """Return the costs of beginning and ending within a segment, None where that may not be."""
    if presence is None:
        return None
    leaving = np.float32(presence.leaving)
    return viterbi.EndCosts(np.float32(presence.entry), leaving,
                            np.float32(0) if last else leaving)
