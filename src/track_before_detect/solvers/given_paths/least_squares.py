"""Amplitudes of given paths without shrinkage (t = 0): least squares, frame by frame."""

import math

import numpy as np

from track_before_detect.kernels.fit import least_squares
from track_before_detect.solvers.given_paths.problem import FittedPaths, Problem
from track_before_detect.types import Step


def fit(problem: Problem, lam: float) -> FittedPaths:
    """Return the least-squares fit, for no norm joins the frames at t = 0."""
    n_parts, n_frames = problem.data.shape[:2]
    correlations = np.zeros((n_parts, problem.n_columns))
    every_path, every_column = np.arange(problem.n_paths), np.arange(problem.n_columns)
    problem.correlate(problem.data, every_column, correlations)
    amplitudes = np.zeros((problem.n_paths, n_parts, n_frames))
    for k in range(n_frames):
        # All paths that meet in a column share its amplitude.
        columns, which, n_sharing = np.unique(problem.columns[:, k], return_inverse=True,
                                              return_counts=True)
        gram = np.empty((len(columns), len(columns), 1))
        problem.fill_gram(problem.column_place[columns, None].astype(np.int64), 0, gram)
        fitted = np.zeros((len(columns), n_parts, 1))
        least_squares.solve(fitted, correlations[:, columns].T[:, :, None].copy(), gram,
                            problem.non_negative)
        amplitudes[:, :, k] = (fitted[:, :, 0] / n_sharing[:, None])[which.ravel()]
    residual = problem.residual(every_path, amplitudes)
    problem.correlate(residual, every_column, correlations)
    largest = problem.fill_statistics(every_path, correlations, np.zeros(problem.n_paths))
    n_active = int(np.count_nonzero(amplitudes.any(axis=(1, 2))))
    objective = 0.5 * float(np.vdot(residual, residual)) + 0.5 * lam**2 * n_active
    return problem.fitted(every_path, amplitudes, math.nan, 'converged',
                          [Step(0.0, objective, n_active, largest / lam)])
