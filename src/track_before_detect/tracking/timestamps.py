"""The check of stamps that every batch and every sensor has to pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError


def check_increasing(stamps: NDArray, name: str) -> None:
    """Raise DataError unless stamps (T,) in seconds are finite and increase.

    Parameters
    ----------
    stamps : array, shape (T,)
        Seconds.
    name : str
        What the sentence calls them.
    """
    if not np.all(np.isfinite(stamps)):
        raise DataError(f'{name} must be finite, got {stamps[~np.isfinite(stamps)][0]}')
    backward = np.flatnonzero(np.diff(stamps) <= 0)
    if len(backward):
        at = int(backward[0])
        raise DataError(f'{name} must increase, got {stamps[at]:g} s and then '
                        f'{stamps[at + 1]:g} s at frame {at + 1}')
