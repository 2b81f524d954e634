"""The spread of the bulk of some values, whatever a few of them are."""

import numpy as np
from numpy.typing import NDArray

MAD_TO_DEVIATION = 1.4826  # median absolute deviation of Gaussian values to their deviation
_CUTOFF = 9.0  # median absolute deviations beyond which a value has no weight
_GAUSSIAN = 1.00918  # what the estimate says of unit Gaussian noise
_ENOUGH = 200_000  # values tell the deviation to 0.2 %
_FLOOR_SPREAD = 5 / 3  # half a grey level at the floor of whole numbers, whose median can be 0


def median_deviation(centred: NDArray) -> float:
    """Return the standard deviation of values about 0, by the median of their magnitudes."""
    return MAD_TO_DEVIATION * float(np.median(np.abs(centred)))


def robust_deviation(values: NDArray, floor: float = 0.0) -> float:
    """Return the standard deviation of the bulk of some values.

    The biweight midvariance about the median: values beyond 9 median absolute deviations have no
    weight. Unlike the median absolute deviation itself it does not move in steps when the values
    are whole numbers.

    Parameters
    ----------
    values : array
        Real values; those that are not finite are left out.
    floor : float, optional
        Least value returned, in the units of ``values``.

    Returns
    -------
    float
        Standard deviation; NaN when no value is finite.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return float('nan')
    finite = finite[::-(-finite.size // _ENOUGH)].astype(np.float64)
    centred = finite - np.median(finite)
    spread = max(float(np.median(np.abs(centred))), _FLOOR_SPREAD * floor)
    if spread == 0:
        return 0.0
    square = (centred / (_CUTOFF * spread)) ** 2
    inside = square < 1
    square, centred = square[inside], centred[inside]
    rest = 1 - square
    above = np.sum(centred ** 2 * rest ** 4)
    below = abs(np.sum(rest * (1 - 5 * square)))
    return max(float(np.sqrt(finite.size * above) / below) / _GAUSSIAN, floor)
