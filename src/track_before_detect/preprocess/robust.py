"""The spread of the bulk of some values, whatever a few of them are."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

MAD_TO_DEVIATION = 1.4826  # median absolute deviation of Gaussian values to their deviation
_CUTOFF = 9.0  # median absolute deviations beyond which a value has no weight
_GAUSSIAN = 1.00918  # what the estimate says of unit Gaussian noise
_ENOUGH = 200_000  # values tell the deviation to 0.2 %
_FLOOR_SPREAD = 5 / 3  # half a grey level at the floor of whole numbers, whose median can be 0


def median(values: NDArray) -> Any:
    """Return the median of all values, which are numbers; at least one.

    Selecting one value is several times as fast as selecting the two that NumPy's median asks for.
    """
    middle = values.size // 2
    ordered = np.partition(values, middle, axis=None)
    if values.size % 2:
        return ordered[middle]
    return values.dtype.type(0.5) * (ordered[:middle].max() + ordered[middle])


def median_deviation(centred: NDArray) -> float:
    """Return the standard deviation of values about 0, by the median of their magnitudes."""
    return MAD_TO_DEVIATION * float(median(np.abs(centred)))


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
    known = np.isfinite(values)
    finite = values.reshape(-1) if known.all() else values[known]
    if not finite.size:
        return float('nan')
    centred = finite[::-(-finite.size // _ENOUGH)].astype(np.float64)
    centred -= median(centred)
    spread = max(float(median(np.abs(centred))), _FLOOR_SPREAD * floor)
    if spread == 0:
        return 0.0
    square = (centred / (_CUTOFF * spread)) ** 2
    rest = np.maximum(1 - square, 0)
    above = np.sum((centred * rest * rest) ** 2)
    below = abs(np.sum(rest * (1 - 5 * square)))
    return max(float(np.sqrt(centred.size * above) / below) / _GAUSSIAN, floor)
