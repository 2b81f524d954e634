"""How well the positions of a refined path are known: Cramér-Rao bound, and what that leaves out.

The bound is that of the smooth motion that was fitted. It knows nothing of two things: amplitudes
are estimated from the same noise, and a motion may be less smooth than the price of its turns
allowed it to be fitted. Both are added here; docs/constants/refine.md says how that was checked.
"""

import numpy as np
from numpy.typing import NDArray

# Share of the energy of a path that is taken for the target's at least, so that the covariance of
# one that might be noise alone stays finite.
LEAST_SHARE = 0.1
# Information in any direction, per px^2, so that what no frame tells is known to be unknown.
LEAST_INFORMATION = 1e-6


def position_covariance(fitted: NDArray, free: NDArray, curvature: NDArray, slopes: NDArray,
                        amplitudes: NDArray, n_numbers: int, variance: float,
                        ) -> NDArray[np.float64]:
    """Return the covariance of the positions of a refined path, as if it were alone.

    Parameters
    ----------
    fitted, free : array, shape (T, 2, B)
        Bases of the motions among which it was refined, and of the freest there are.
    curvature : array, shape (T, 2, 2)
        Of the statistic of each frame where the amplitude is one.
    slopes : array, shape (T, 2)
        Of the statistic of each frame in x and y, where the path is.
    amplitudes : array, shape (T,)
        Those that fit best, in units of the noise.
    n_numbers : int
        Of how many real numbers they are made.
    variance : float
        Of the noise of such a number.

    Returns
    -------
    array, shape (T, 2, 2)
        Pixels squared, x before y.
    """
    energy = float(np.sum(amplitudes**2))
    n_fitted, n_free = fitted.shape[2], free.shape[2]
    # What noise alone adds to the energy through every number that is fitted.
    noise = variance * (n_numbers + n_fitted)
    share = max(1 - noise / max(energy, 1e-300), LEAST_SHARE)
    information = amplitudes[:, None, None]**2 * curvature
    # The statistic falls off by as much as the target's own share of the energy; its slope is as
    # uncertain as all of it.
    known, known_if_free = (
        _covariances(basis, information * share**2 / variance) for basis in (fitted, free))
    # Where the motion would go if it were free; what of that is more than noise is the weight that
    # it is.
    slope = (amplitudes[:, None] * slopes).ravel() @ _rows(free)
    step = np.linalg.solve(_normal(free, information), slope)
    excess = max(float(slope @ step) / variance, 1e-300)
    weight = max(1 - (n_free - n_fitted) / excess, 0.0)
    moved = free @ step / share
    known_if_free += moved[:, :, None] * moved[:, None, :]
    return (1 - weight) * known + weight * known_if_free


def _rows(basis: NDArray) -> NDArray[np.float64]:
    return basis.reshape(-1, basis.shape[2])


def _normal(basis: NDArray, information: NDArray) -> NDArray[np.float64]:
    normal = _rows(basis).T @ _rows(information @ basis)
    return normal + LEAST_INFORMATION * np.eye(len(normal))


def _covariances(basis: NDArray, information: NDArray) -> NDArray[np.float64]:
    """Return the covariance (T, 2, 2) of motions of a basis (T, 2, B)."""
    return basis @ np.linalg.inv(_normal(basis, information)) @ basis.swapaxes(1, 2)
