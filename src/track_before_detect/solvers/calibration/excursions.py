"""How many paths of noise pass a level, by the geometry of random fields.

The statistic of a straight path is a smooth random field over its first position and its velocity.
High up, the places where it passes u are islands, and their number is on average

    sum over i, k of  L_i(positions) L_k(velocities) rho_{i + k}(u)

(Taylor and Adler, Random Fields and Geometry, 2007; Worsley, Local maxima and the expected Euler
characteristic of excursion sets of chi-squared, F and t fields, 1994). The L measure how large the
set is, in lengths over which the field changes, and rho says how rare such a value is; a statistic
that is a norm of normal numbers has

    rho_j(u) = (2 pi)^(-j/2) (-d/du)^j P(statistic > u).

The number of normal numbers is that of the frames, or, where amplitudes are not negative, that of
the frames in which the path sees more than nothing, each as often as not.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc, gammaln

DIMENSIONS = 4


def densities(level: float, numbers: NDArray) -> NDArray[np.float64]:
    """Return rho_j of norms of normal numbers, shape (DIMENSIONS + 1, N).

    Parameters
    ----------
    level : float
        u, above 0.
    numbers : array of float, shape (N,)
        How many numbers each norm is of.
    """
    scale = np.exp((1 - numbers / 2) * math.log(2) - gammaln(numbers / 2)
                   + (numbers - 1) * math.log(level) - level**2 / 2)
    # The derivatives of u^(n-1) exp(-u^2/2) are that times a sum of powers of u.
    powers = {0: np.ones_like(numbers)}
    found = [gammaincc(numbers / 2, level**2 / 2)]
    for j in range(1, DIMENSIONS + 1):
        found.append((2 * math.pi)**(-j / 2) * scale
                     * sum(factor * level**power for power, factor in powers.items()))
        following: dict[int, NDArray] = {}
        for power, factor in powers.items():
            following[power + 1] = following.get(power + 1, 0.0) + factor
            following[power - 1] = (following.get(power - 1, 0.0)
                                    - (numbers - 1 + power) * factor)
        powers = following
    return np.array(found)


def mixture(n_frames: int, constant: bool, signed: bool) -> tuple[NDArray, NDArray]:
    """Return how many normal numbers a statistic is the norm of, and how often, both (N,)."""
    most = 1 if constant else n_frames
    if signed:
        return np.array([float(most)]), np.ones(1)
    numbers = np.arange(1.0, most + 1)
    chances = np.exp(gammaln(most + 1) - gammaln(numbers + 1) - gammaln(most - numbers + 1)
                     - most * math.log(2))
    return numbers, chances


def expected_islands(level: float, n_frames: int, constant: bool, signed: bool,
                     rooms: NDArray, radius: float) -> float:
    """Return how many islands of straight paths pass a level on average.

    Parameters
    ----------
    level : float
        u, above 0.
    n_frames : int
        T.
    constant : bool
        Whether one amplitude serves all frames.
    signed : bool
        Whether amplitudes may have either sign.
    rooms : array, shape (V, 2)
        Width and height in which paths of each velocity can start, in lengths over which the
        matched filter changes, one over the root of the curvature of the PSF.
    radius : float
        Largest speed, in these lengths per frame interval; 0 of targets that stand still.
    """
    numbers, chances = mixture(n_frames, constant, signed)
    rho = densities(level, numbers) * chances
    # What a frame adds weighs how far a change of velocity is seen there: few that count, by
    # chance, spread less in time than all.
    spread = math.sqrt((n_frames**2 - 1) / 12)
    spreads = spread * (np.ones_like(numbers) if constant
                        else np.sqrt(np.maximum(1 - 3 / (numbers + 2), 0.0)))
    places = (1.0, float(rooms.sum(axis=1).mean()), float(rooms.prod(axis=1).mean()))
    motions = (1.0, math.pi * radius, math.pi * radius**2)
    return float(sum(
        places[i] * motions[k] * np.sum(rho[i + k] * spreads**k)
        for i in range(3) for k in range(3 if radius > 0 else 1)))
