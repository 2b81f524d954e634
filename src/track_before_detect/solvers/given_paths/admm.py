"""The alternating direction method of multipliers for the group lasso over a working set.

The smooth part and the norms get variables of their own, x and u, that the method brings
together: x solves one linear system per frame, u is a group shrinkage with the closed form of
Algorithm 2 whatever the weights, so that no line search is needed (Patent, after Algorithm 2).
"""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.fit.group_lasso import value_and_gap

# Rounds between two looks at the gap, and at the balance of the two residuals.
ROUNDS_PER_LOOK = 10
# Ratio of the residuals from which the penalty on x - u is changed, and by how much.
MOST_IMBALANCE = 5.0
CHANGE = 2.0
RELAXATION = 1.6


def solve(amplitudes: NDArray, matched: NDArray, gram: NDArray, slack: NDArray, weight: float,
          non_negative: bool, energy: float, gap_wanted: float,
          most_rounds: int) -> tuple[float, int]:
    """Minimise 1/2 x'Gx - h'x + weight sum_p |x_p| in place; return (gap, rounds made).

    Arguments, in place where they are, as of ``solve`` of the kernels ``group_lasso``.
    """
    of_frames = gram.transpose(2, 0, 1)
    identity = np.eye(len(gram))
    penalty = float(np.einsum('ppt->', gram)) / max(gram.shape[0] * gram.shape[2], 1)
    inverse = np.linalg.inv(of_frames + penalty * identity)
    u, dual = amplitudes.copy(), np.zeros_like(amplitudes)
    gap = float('inf')
    for rounds in range(1, most_rounds + 1):
        before = u
        x = np.einsum('tpq,qdt->pdt', inverse, matched + penalty * (u - dual))
        towards = RELAXATION * x + (1 - RELAXATION) * u + dual
        u = np.maximum(towards, 0.0) if non_negative else towards
        norms = np.sqrt(np.einsum('pdt,pdt->p', u, u))
        factors = np.maximum(norms - weight / penalty, 0.0) / np.maximum(norms, 1e-300)
        u = u * factors[:, None, None]
        dual = towards - u
        if rounds % ROUNDS_PER_LOOK:
            continue
        amplitudes[:] = u
        slack[:] = matched - np.einsum('pqt,qdt->pdt', gram, u)
        _, gap, _ = value_and_gap(amplitudes, matched, slack, weight, non_negative, energy)
        if gap <= gap_wanted:
            return gap, rounds
        apart = float(np.linalg.norm(x - u))
        moved = penalty * float(np.linalg.norm(u - before))
        change = 1.0
        if apart > MOST_IMBALANCE * moved:
            change = CHANGE
        elif moved > MOST_IMBALANCE * apart:
            change = 1 / CHANGE
        if change != 1.0:
            penalty *= change
            dual /= change
            inverse = np.linalg.inv(of_frames + penalty * identity)
    return gap, most_rounds + 1
