"""Search of the best paths of targets that may enter and leave during the batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.search import partial_viterbi as partial_search
from track_before_detect.kernels.search.viterbi import ABSENT
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search.path_search import FoundPath, PathSearch


class PartialSearch(PathSearch):
    """Finds the best paths, which need not last from the first frame to the last.

    Positions of a path are NaN in the frames where it is absent; its cost includes that of being
    present.

    Parameters
    ----------
    graph, psf, shape, model, n_threads
        As for PathSearch.
    presence : Presence
        Cost of being present.
    """

    def __init__(self, graph: StateGraph, psf: Psf | MultiSensor, shape: tuple[int, int],
                 model: AmplitudeModel, presence: Presence, n_threads: int = 1):
        super().__init__(graph, psf, shape, model, n_threads)
        self._presence = presence
        self._values = np.empty((0, 0, 0, 0), np.float32)
        self._met = np.empty((0, 0, 0), np.float32)
        self._ends = np.empty((0, 0, 0), np.float32)
        self._searched_at = presence

    def run(self, scores: NDArray) -> NDArray:
        """Fill the table; return the best by segment of the end and its start, (J, Y, X)."""
        graph, presence = self.graph, self._presence
        n_y, n_x = self.grid_shape
        # Where nothing is found, the frames are searched twice.
        if presence == self._searched_at and np.array_equal(scores, self._met):
            return self._ends.copy()
        self._searched_at = presence
        if not len(self._values):
            self._values = np.empty((graph.n_segments, n_y, graph.n_velocities, n_x), np.float32)
        self._met = scores
        ends = np.empty((graph.n_segments, n_y, n_x), np.float32)
        for j in range(graph.n_segments):
            before = self._values[j - 1] if j else self._values[0, :0]
            self._table.over_rows(
                partial_search.forward_segment, self._values[j], ends[j], before, scores,
                graph.moves, graph.end_moves[max(j - 1, 0)], graph.knots[j], graph.knots[j + 1],
                graph.row_first, graph.row_x, graph.reach, np.float32(graph.turn_cost),
                np.float32(presence.per_frame), np.float32(presence.entry),
                np.float32(presence.leaving))
        self._ends = ends
        return ends.copy()

    def best_paths(self, frames: NDArray, above: float, separation: float,
                   is_new: Callable[[NDArray], bool], limit: int,
                   ) -> tuple[float, list[FoundPath]]:
        """Return the largest value of any path, and separate paths with values above a bound."""
        ends = self.run(self.scores(frames))
        largest = float(ends.max())
        radius = max(1, round(separation / self.graph.step_px))
        return largest, [path for path in self._ended_paths(ends, above, radius, limit)
                         if is_new(path.positions)]

    def _ended_paths(self, ends, above, radius, limit):
        """Yield the paths of the largest values above a bound, the largest first, and apart."""
        for _ in range(limit):
            j, y, x = (int(i) for i in np.unravel_index(int(np.argmax(ends)), ends.shape))
            if not ends[j, y, x] > above:
                return
            path, starts = self._trace_back(j, y, x)
            yield path
            # The same target ends in other segments, too, a little less well.
            for segment, (start_x, start_y) in starts.items():
                ends[segment, max(0, start_y - radius):max(0, start_y + radius + 1),
                     max(0, start_x - radius):max(0, start_x + radius + 1)] = ABSENT

    def _trace_back(self, j, y, x):
        """Return the best path that ends in segment ``j``, and where it starts each segment."""
        graph = self.graph
        n_y, n_x = self.grid_shape
        positions = np.full((graph.n_frames, 2), np.nan)
        starts: dict[int, tuple[int, int]] = {}
        arrivals, before = self._arrivals(j, y, x)
        reached = self._reached(j, y, x, np.arange(graph.n_velocities), arrivals)
        frames = np.arange(graph.knots[j], graph.knots[j + 1])
        ends = reached - self._presence.leaving * (frames < graph.n_frames - 1)[:, None]
        k, velocity = (int(i) for i in np.unravel_index(int(np.argmax(ends)), ends.shape))
        value, cost = float(ends[k, velocity]), 0.0
        end = last = int(frames[k])
        self._go_on(starts, j, y, x, velocity)
        while True:
            first = int(graph.knots[j])
            starts[j] = (x, y)
            line = (x, y) + graph.moves[first:end + 1, velocity]
            entered = self._entered(j, y, x, velocity, arrivals[velocity], end)
            positions[first + entered:end + 1] = line[entered:]
            if entered > 0 or j == 0 or arrivals[velocity] <= -self._presence.entry:
                first += entered
                break
            steps = np.abs(graph.grid - graph.grid[velocity])
            near = np.flatnonzero(steps.max(axis=1) <= graph.reach)
            turn = graph.turn_cost * steps[near].sum(axis=1)
            chosen = int(np.argmax(before[near] - turn))
            cost += float(turn[chosen])
            velocity = int(near[chosen])
            j -= 1
            x -= int(graph.end_moves[j, velocity, 0])
            y -= int(graph.end_moves[j, velocity, 1])
            arrivals, before = self._arrivals(j, y, x)
            end = int(graph.knots[j + 1]) - 1
        cost += self._presence.cost(first, last, graph.n_frames)
        if self._plane:
            present = np.arange(first, last + 1)
            positions[present] = self._plane.restore(positions[present], present)
        return FoundPath(positions * graph.step_px, value, cost), starts

    def _go_on(self, starts, j, y, x, velocity):
        """Add to ``starts`` where the path would start the segments after its end."""
        graph = self.graph
        for segment in range(j + 1, graph.n_segments):
            x, y = (x, y) + graph.end_moves[segment - 1, velocity]
            starts[segment] = (int(x), int(y))

    def _arrivals(self, j, y, x):
        """Return the best weight before segment ``j`` by its velocity, and by the one before it.

        Both for the start (y, x) of the segment; zero in the first, which nothing is before.
        """
        graph = self.graph
        n_v = graph.n_velocities
        if j == 0:
            return np.zeros(n_v), np.full(n_v, float(ABSENT))
        n_y, n_x = self.grid_shape
        from_x = x - graph.end_moves[j - 1, :, 0]
        from_y = y - graph.end_moves[j - 1, :, 1]
        inside = (from_x >= 0) & (from_x < n_x) & (from_y >= 0) & (from_y < n_y)
        before = np.full(n_v, float(ABSENT))
        before[inside] = self._values[j - 1, from_y[inside], np.flatnonzero(inside),
                                      from_x[inside]]
        columns, rows = graph.grid.T
        reach = graph.reach
        table = np.full((rows.max() + 1 + 2 * reach, columns.max() + 1 + 2 * reach),
                        float(ABSENT))
        table[rows + reach, columns + reach] = before
        best = np.full(n_v, float(ABSENT))
        for d_y in range(-reach, reach + 1):
            for d_x in range(-reach, reach + 1):
                cost = graph.turn_cost * (abs(d_x) + abs(d_y))
                best = np.maximum(best, table[rows + reach + d_y, columns + reach + d_x] - cost)
        return best, before

    def _reached(self, j, y, x, velocities, arrivals):
        """Return the weight reached in each frame of a segment, shape (frames, velocities)."""
        presence = self._presence
        gains = self._gains(j, y, x, velocities)
        reached = np.empty_like(gains)
        now = arrivals
        for row, gain in enumerate(gains):
            now = np.maximum(now, -presence.entry) + gain - presence.per_frame
            reached[row] = now
        return reached

    def _gains(self, j, y, x, velocities):
        """Return the scores met along a segment, ABSENT off the grid."""
        graph = self.graph
        n_y, n_x = self.grid_shape
        frames = np.arange(graph.knots[j], graph.knots[j + 1])
        at = (x, y) + graph.moves[frames][:, velocities]
        inside = np.all((at >= 0) & (at < (n_x, n_y)), axis=2)
        at = np.where(inside[..., None], at, 0)
        met = self._met[frames[:, None], at[..., 1], at[..., 0]]
        return np.where(inside, met, float(ABSENT))

    def _entered(self, j, y, x, velocity, arrival, end):
        """Return the frame of a segment in which the path enters, 0 if it was there before."""
        presence = self._presence
        gains = self._gains(j, y, x, [velocity])[:, 0]
        entered, now = 0, arrival
        for k in range(end - self.graph.knots[j] + 1):
            if k > 0 and now <= -presence.entry:
                entered = k
            now = max(now, -presence.entry) + gains[k] - presence.per_frame
        return entered
