"""Whether a batch can be noise with targets in it, before it is searched for them.

In noise, the threshold is passed somewhere in a batch as rarely as a false alarm is asked for, and
a target lets the places around it pass. Where most places of the plane pass, and still do with the
best targets taken off, there is no noise that the threshold could be a threshold for: frames whose
background was not removed, or whose noise is far above one. A search would find a target at every
place, and come to no end.
"""

import math

import numpy as np

from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.fit.working_set import WorkingSet
from track_before_detect.solvers.refine.refinement import PathRefiner
from track_before_detect.solvers.search.path_search import PathSearch
from track_before_detect.solvers.watch import Watch

# Places that are looked at, and the share of them that has to pass.
N_PLACES = 100
MOST = 0.5
# Targets that are taken off before the second look: at least so many, and as many as would cover
# this share of the plane, each as wide as new paths of a search are apart, in widths of the PSF.
LEAST_TARGETS = 8
COVERED = 0.25
ACROSS = 6.0


def threshold_bound(graph: StateGraph, grid_shape: tuple[int, int], rate: float) -> float:
    """Return what no calibrated threshold exceeds.

    The norm of T normal numbers exceeds sqrt(T) + s with a probability below exp(-s^2 / 2), and
    the probability that that of any path does is at most the sum over all paths.
    """
    n_turns = (2 * graph.reach + 1)**2
    n_paths = (math.log(math.prod(grid_shape) * graph.n_velocities)
               + (graph.n_segments - 1) * math.log(n_turns))
    return math.sqrt(graph.n_frames) + math.sqrt(2 * (n_paths - math.log(rate)))


def passes_everywhere(search: PathSearch, refiner: PathRefiner, paths: WorkingSet,
                      measurement: MeasurementModel, cost: float, watch: Watch) -> bool:
    """Return whether most places pass the threshold, with or without the best targets.

    Parameters
    ----------
    search : PathSearch
        Finds the best paths.
    refiner : PathRefiner
        Moves a path off the grid.
    paths : WorkingSet
        Holds the frames, and no path before and after.
    measurement : MeasurementModel
        What a target looks like.
    cost : float
        Of a path that stands still in all frames.
    watch : Watch
        Says when the time is up; no more is taken off then.
    """
    if _share_passing(paths, measurement, cost) <= MOST:
        return False
    _take_off_the_best(search, refiner, paths, measurement, watch)
    share = _share_passing(paths, measurement, cost)
    paths.remove(np.arange(len(paths)))
    paths.refresh()
    return share > MOST and not watch.stopped


def _share_passing(paths: WorkingSet, measurement: MeasurementModel, cost: float) -> float:
    """Return the share of places at which a target that stands still would pass."""
    n_frames, height, width = paths.frames.shape
    right, bottom = measurement.limits((height, width))
    n_rows = min(height, max(round(N_PLACES**0.5), N_PLACES // width))
    n_columns = min(width, N_PLACES // n_rows)
    places = [(x, y) for y in np.linspace(0.0, bottom, n_rows)
              for x in np.linspace(0.0, right, n_columns)]

    def share(of: list[tuple[float, float]]) -> float:
        excess = np.array([paths.excess_at(np.full((n_frames, 2), place), cost) for place in of])
        seen = excess[np.isfinite(excess)]
        return float(np.mean(seen > 0)) if len(seen) else 0.0

    # In noise none of a few places passes, and where most do, some of a few does: all but always
    # the few are enough. One step short of a row they lie on a diagonal.
    few = places[::max(n_columns - 1, 1)]
    return share(few) and share(places)


def _take_off_the_best(search: PathSearch, refiner: PathRefiner, paths: WorkingSet,
                       measurement: MeasurementModel, watch: Watch) -> None:
    """Take the best paths that are apart off the residual, one after the other."""
    across = ACROSS * measurement.width_px
    cells = np.prod([max(side / across, 1.0) for side in paths.frames.shape[1:]])
    _, found = search.best_paths(
        paths.residual, paths.model.value(paths.least_penalty), 0.5 * across,
        max(LEAST_TARGETS, int(COVERED * cells)))
    for path in found:
        if watch.time_is_up():
            return
        positions, cost = refiner.refine(
            paths.residual, path.positions, path.cost, paths.least_penalty, 0.0,
        ) or (path.positions, path.cost)
        added = paths.add(positions, cost)
        if paths.statistic(added) > paths.penalties[added]:
            paths.assign(np.array([added]), paths.best(added)[None])
