"""Checks of what is given, each said once: numbers in their range, frames, stamps."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.errors import DataError, ParameterError

# Time is taken for the last axis where the first two look like the sides of a picture and the last
# is too short for one (docs/constants/outside_the_search.md).
SHORTEST_PICTURE_PX = 64
WIDEST_PICTURE = 2.5
LONGEST_PICTURE = 5


def checked_number(name: str, value: Any, *, whole: bool = False, above: float | None = None,
                   minimum: float | None = None, maximum: float | None = None,
                   unit: str = '') -> Any:
    """Return a finite number within its range, as an int where it has to be whole, else a float.

    Parameters
    ----------
    name : str
        What the sentence calls it.
    value : number
        No text and no truth value, which to Python is a whole number.
    whole : bool
        Whether a fraction is refused.
    above, minimum, maximum : float, optional
        An exclusive lower bound, and inclusive ones.
    unit : str
        Of the bounds, for the sentence.
    """
    try:
        if isinstance(value, (str, bytes, bool, np.bool_)):
            raise TypeError
        number = float(value)
        if not math.isfinite(number) or (whole and number != int(number)):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise ParameterError(
            f'{name} must be a {"whole " if whole else ""}number, got {value!r}') from None
    for bound, holds, words in (
            (above, above is None or number > above, 'above'),
            (minimum, minimum is None or number >= minimum, 'at least'),
            (maximum, maximum is None or number <= maximum, 'at most')):
        if not holds:
            raise ParameterError(f'{name} must be {words} {bound:g}{unit and " "}{unit}, got '
                                 f'{number:g}')
    return int(number) if whole else number


def as_array(name: str, values: ArrayLike) -> NDArray:
    """Return values as an array, or raise DataError where they are none."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as error:
        raise DataError(f'{name} must be an array of numbers: {error}') from error


def checked_frames(values: ArrayLike, name: str = 'frames', kinds: str = 'iufc') -> NDArray:
    """Return frames (T, H, W) as they are, or raise DataError where they are no numbers.

    ``kinds`` are the NumPy kinds of numbers that will do. What an array of ``numpy.ma`` masks is
    NaN.
    """
    masked: Any = values
    if isinstance(values, (list, tuple)) and any(np.ma.is_masked(frame) for frame in values):
        masked = np.ma.stack(values)
    frames = as_array(name, masked)
    if frames.ndim != 3 or 0 in frames.shape:
        raise DataError(
            f'{name} must have shape (T, H, W) with no empty side, got {frames.shape}')
    if frames.dtype.kind not in kinds:
        raise DataError(f'{name} must hold {"" if "c" in kinds else "real "}numbers, got '
                        f'{frames.dtype}')
    if np.ma.is_masked(masked):
        # The smallest type that holds NaN and the numbers as they are.
        frames = frames.astype(np.result_type(frames.dtype, np.float32))
        frames[np.ma.getmaskarray(masked)] = np.nan
    return frames


def check_axes(shape: tuple[int, ...], name: str) -> None:
    """Refuse frames (H, W, T), which show themselves by a last axis shorter than any picture's."""
    first, second, last = shape
    if (last > 1 and min(first, second) >= max(SHORTEST_PICTURE_PX, LONGEST_PICTURE * last)
            and max(first, second) <= WIDEST_PICTURE * min(first, second)):
        raise DataError(
            f'{name} must have shape (T, H, W), got {shape}, which looks like (H, W, T): '
            'np.moveaxis(frames, -1, 0) puts time first; pictures that are as narrow can be '
            'turned, np.swapaxes(frames, 1, 2)')


def check_kind(frames: NDArray, amplitudes: str) -> None:
    """Refuse complex frames for real amplitudes, and real ones for complex amplitudes."""
    if np.iscomplexobj(frames) != (amplitudes == 'complex'):
        kind, wanted = (('complex', 'complex') if np.iscomplexobj(frames) else
                        ('real', 'non-negative or signed'))
        raise DataError(f'frames of {kind} numbers need amplitudes {wanted}, got {amplitudes}')


def checked_stamps(values: ArrayLike, n_frames: int, name: str = 'stamps') -> NDArray[np.float64]:
    """Return the stamps (T,) of frames in seconds, finite and increasing, or raise DataError."""
    stamps = as_array(name, values)
    if stamps.dtype.kind not in 'iuf':
        raise DataError(f'{name} must be real numbers in seconds, got {stamps.dtype}')
    if stamps.shape != (n_frames,):
        raise DataError(f'{name} must have shape ({n_frames},), got {stamps.shape}')
    stamps = stamps.astype(float)
    if not np.all(np.isfinite(stamps)):
        raise DataError(f'{name} must be finite, got {stamps[~np.isfinite(stamps)][0]}')
    backward = np.flatnonzero(np.diff(stamps) <= 0)
    if len(backward):
        at = int(backward[0])
        raise DataError(f'{name} must increase, got {stamps[at]:g} s and then '
                        f'{stamps[at + 1]:g} s at frame {at + 1}')
    return stamps
