"""Begin a batch with the paths that targets of the batch before would take.

A path is cut to the frames both batches hold, carried on at its last velocity, and put on the
nearest path of the state graph. So it is one that the search could find as well, and is taken on
the same terms: it has to pass its weight on what the others leave, and F_t has to fall. What the
convex stage converges to is that of a cold start; only the way there is shorter.
"""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.batch_detector import EarlierPaths
from track_before_detect.solvers.search.path_search import FoundPath

# Grid steps around the first position, and velocities nearest to the mean one of a segment, among
# which the path of the graph is chosen. A path drifts off by up to 1.5 steps (STEPS_PER_SEGMENT of
# the module state_graph).
START_STEPS = 2
NEAR_VELOCITIES = 9


def starting_paths(graph: StateGraph, times: NDArray, limits: NDArray,
                   earlier: EarlierPaths, presence: Presence | None = None) -> list[FoundPath]:
    """Return the paths of a graph that carry on those of an earlier batch.

    Parameters
    ----------
    graph : StateGraph
        Of the batch to be searched.
    times : array, shape (T,)
        Of its frames, in any unit.
    limits : array, shape (2,)
        Largest x and y of a position in pixels.
    earlier : EarlierPaths
        What the batch before found.
    presence : Presence, optional
        Cost of being present, where a path may be absent from some frames.

    Returns
    -------
    list of FoundPath
        Those that stay inside; their values are not known.
    """
    known, n_frames = earlier.known, len(times)
    present = [known & np.isfinite(positions[:, 0]) for positions in earlier.positions]
    seen = [number for number, frames in enumerate(present) if frames.any()]
    if not seen:
        return []
    span = float(np.ptp(times)) / graph.n_segments
    # On this plane a target of constant velocity, or of constant Doppler, goes straight on.
    coupling = graph.coupling
    wanted = np.array([
        _carried_on(coupling.on_plane(positions) if coupling else positions, present[number],
                    times, span)
        for number, positions in enumerate(earlier.positions) if number in seen])
    paths, turns = _nearest_paths(graph, wanted / graph.step_px)
    if coupling:
        n_columns = round(limits[0] / graph.step_px) + 1
        columns = np.clip(paths[..., 0].astype(int), 0, n_columns - 1)
        shifts = coupling.shifts(n_columns, graph.step_px)
        paths[..., 1] += shifts[np.arange(n_frames), columns]
    paths *= graph.step_px
    inside = np.all((paths >= 0) & (paths <= limits + 1e-9), axis=2)
    found = []
    for row in np.flatnonzero(np.isfinite(turns)):
        path, cost = paths[row], float(graph.turn_cost * turns[row])
        first, last = 0, n_frames - 1
        if presence is not None:
            # A target that has not left by the last common frame is still there in the new ones,
            # until it leaves the frame.
            there = present[seen[row]]
            there = there | (~known & there[np.flatnonzero(known)[-1]])
            first, last = (int(frame) for frame in np.flatnonzero(there)[[0, -1]])
            last = first + int(np.argmin(np.append(inside[row, first:last + 1], False))) - 1
            path[:first] = path[last + 1:] = np.nan
            cost += presence.cost(first, last, n_frames)
        if first <= last and inside[row, first:last + 1].all():
            found.append(FoundPath(path, float('nan'), cost))
    return found


def _carried_on(positions: NDArray, present: NDArray, times: NDArray,
                span: float) -> NDArray[np.float64]:
    """Return a path in all frames: straight on beyond its ends at the velocity near them."""
    seen, at = times[present], positions[present]
    out = np.stack([np.interp(times, seen, column) for column in at.T], axis=1)
    for end, beyond in ((0, times < seen[0]), (-1, times > seen[-1])):
        if not beyond.any():
            continue
        near = np.abs(seen - seen[end]) <= span
        elapsed = seen[near] - seen[near].mean()
        squares = float(elapsed @ elapsed)
        velocity = elapsed @ at[near] / squares if squares > 0 else np.zeros(2)
        out[beyond] = at[end] + (times[beyond] - seen[end])[:, None] * velocity
    return out


def _nearest_paths(graph: StateGraph, wanted: NDArray) -> tuple[NDArray, NDArray]:
    """Return the paths (P, T, 2) of the graph near positions, in grid steps, and their turns (P,).

    From every start near the first position the velocities follow one by one, each the one that
    leads along the positions best; the start from which that goes best is taken. The turns are
    infinite where the graph allows none of that.
    """
    around = np.arange(-START_STEPS, START_STEPS + 1)
    starts = np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
    at = np.rint(wanted[:, None, 0]) + starts
    n_paths, n_starts, n_frames = len(wanted), len(starts), graph.n_frames
    row, column = np.ogrid[:n_paths, :n_starts]
    error, turns = np.zeros((2, n_paths, n_starts))
    before = np.empty(0)
    paths = np.empty((n_paths, n_starts, n_frames, 2))
    for j in range(graph.n_segments):
        first, last = graph.knots[j], graph.knots[j + 1]
        frames, moves = np.arange(first, last), graph.moves[first:last]
        if last < n_frames:
            # The next segment begins where this one ends.
            frames = np.append(frames, last)
            moves = np.concatenate([moves, graph.end_moves[j:j + 1]])
        goal = wanted[:, frames]
        # The velocities that lead over the segment about as far as wanted.
        away = np.sum((moves[-1] - (goal[:, -1] - goal[:, 0])[:, None])**2, axis=2)
        near = np.argsort(away, axis=1, kind='stable')[:, :NEAR_VELOCITIES]
        lines = moves[:, near].transpose(1, 2, 0, 3)
        off = np.sum((at[:, :, None, None] + (lines - goal[:, None])[:, None])**2, axis=(3, 4))
        steps = np.zeros(off.shape)
        if j:
            change = np.abs(graph.grid[near][:, None] - before[:, :, None])
            steps = np.where(change.max(axis=3) > graph.reach, np.inf, change.sum(axis=3))
            off[np.isinf(steps)] = np.inf
        best = np.argmin(off, axis=2)
        error += off[row, column, best]
        turns += steps[row, column, best]
        paths[:, :, first:last] = at[:, :, None] + lines[row, best][:, :, :last - first]
        velocity = near[row, best]
        before = graph.grid[velocity]
        at = at + graph.end_moves[j, velocity]
    chosen = np.argmin(error, axis=1)
    every = np.arange(n_paths)
    return paths[every, chosen], turns[every, chosen]
