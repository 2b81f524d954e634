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


def densities(levels: NDArray, numbers: NDArray) -> NDArray[np.float64]:
    """Return rho_j of norms of normal numbers, shape (DIMENSIONS + 1, R, N).

    Parameters
    ----------
    levels : float array, shape (R, 1)
        u, above 0.
    numbers : array of float, shape (R, N) or (1, N)
        How many numbers each norm is of.
    """
    scale = np.exp((1 - numbers / 2) * math.log(2) - gammaln(numbers / 2)
                   + (numbers - 1) * np.log(levels) - levels**2 / 2)
    # The derivatives of u^(n-1) exp(-u^2/2) are that times a sum of powers of u.
    powers = {0: np.ones_like(numbers)}
    found = [gammaincc(numbers / 2, levels**2 / 2)]
    for j in range(1, DIMENSIONS + 1):
        found.append((2 * math.pi)**(-j / 2) * scale
                     * sum(factor * levels**power for power, factor in powers.items()))
        following: dict[int, NDArray] = {}
        for power, factor in powers.items():
            following[power + 1] = following.get(power + 1, 0.0) + factor
            following[power - 1] = (following.get(power - 1, 0.0)
                                    - (numbers - 1 + power) * factor)
        powers = following
    return np.array(found)


def mixture(lengths: NDArray, constant: bool, signed: bool) -> tuple[NDArray, NDArray]:
    """Return how many normal numbers a statistic is the norm of, and how often.

    Parameters
    ----------
    lengths : array of int, shape (R, 1)
        Frames that the path is seen in.
    constant, signed : bool
        Whether one amplitude serves all frames, and may have either sign.

    Returns
    -------
    numbers, chances : float array, broadcast to (R, N)
        Chances are zero of more numbers than frames.
    """
    most = np.ones_like(lengths) if constant else lengths
    if signed:
        return most.astype(float), np.ones(most.shape)
    numbers = np.arange(1.0, most.max() + 1)[None]
    chances = np.exp(gammaln(most + 1) - gammaln(numbers + 1)
                     - gammaln(np.maximum(most - numbers + 1, 1)) - most * math.log(2))
    return numbers, np.where(numbers <= most, chances, 0.0)


def expected_islands(levels: NDArray, lengths: NDArray, constant: bool, signed: bool,
                     places: NDArray, radius: float) -> NDArray[np.float64]:
    """Return how many islands of straight paths pass a level on average, shape (R,).

    Parameters
    ----------
    levels : float array, shape (R,)
        u, above 0.
    lengths : array of int, shape (R,)
        Frames that the paths are seen in.
    constant : bool
        Whether one amplitude serves all frames.
    signed : bool
        Whether amplitudes may have either sign.
    places : array, shape (3, R)
        Mean over the velocities of the L_i of where such paths can start, in lengths over which
        the matched filter changes, one over the root of the curvature of the PSF.
    radius : float
        Largest speed, in these lengths per frame interval; 0 of targets that stand still.
    """
    lengths = lengths[:, None]
    numbers, chances = mixture(lengths, constant, signed)
    rho = densities(levels[:, None], numbers) * chances
    # What a frame adds weighs how far a change of velocity is seen there: few that count, by
    # chance, spread less in time than all.
    spread = np.sqrt((lengths**2 - 1) / 12)
    spreads = spread * (np.ones_like(numbers) if constant
                        else np.sqrt(np.maximum(1 - 3 / (numbers + 2), 0.0)))
    motions = (1.0, math.pi * radius, math.pi * radius**2)
    found: NDArray[np.float64] = sum(
        places[i] * motions[k] * np.sum(rho[i + k] * spreads**k, axis=1)
        for i in range(3) for k in range(3 if radius > 0 else 1))
    return found
