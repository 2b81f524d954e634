"""How far a convex solution can be from the best there is: its duality gap."""

import numpy as np

from track_before_detect.solvers.fit.working_set import WorkingSet


def duality_gap(paths: WorkingSet, largest: float) -> float:
    """Return the duality gap of F_1 at the present amplitudes.

    The residual, scaled down until no path passes its penalty, is feasible for the dual; one
    scale serves all penalties w^2 = threshold^2 + cost, since costs only help once scaled.

    Parameters
    ----------
    paths : WorkingSet
        The solution.
    largest : float
        Largest value of any path on the residual.
    """
    scale = 1.0
    if largest > 0:
        scale = min(scale, paths.least_penalty / paths.model.from_value(largest))
    explained = paths.explained()
    left = paths.matched - explained
    seen = np.array([paths.statistic(path, row) for path, row in enumerate(left)])
    if len(paths):
        scale = min(scale, float(np.min(paths.penalties / np.maximum(seen, 1e-300))))
    fit = np.vdot(paths.amplitudes, explained).real
    cross = np.vdot(paths.amplitudes, paths.matched).real
    residual_energy = paths.energy - cross + 0.5 * fit
    data_times_residual = 2 * paths.energy - cross
    dual = scale * data_times_residual - scale**2 * residual_energy
    return max(0.0, paths.objective(1.0) - float(dual))
