"""Stamps of frames: their unit, their order, and the pauses between them."""

from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

# Units that stamps are written in, by how many make a second, and the first second of 2001 in
# each: what counts from 1970 is past that.
UNITS = ((1e9, 'nanoseconds'), (1e6, 'microseconds'), (1e3, 'milliseconds'))
YEAR_2001_S = 978307200.0
# Seconds between frames that no sensor waits, but nanoseconds and microseconds come to.
LONGEST_INTERVAL_S = 1e4
# Seconds between frames that are usual: a million is a millisecond, or a second in microseconds.
SHORTEST_INTERVAL_S = 1e-3
# Frames of a piece between two pauses that are worth a batch of their own.
SHORTEST_PIECE = 3


def in_seconds(stamps: NDArray) -> tuple[NDArray[np.float64], str]:
    """Return stamps in seconds, and the name of the unit they came in.

    Whole numbers that count from 1970, or that lie further apart than frames can, say by their
    size what they are; everything else is seconds.

    Parameters
    ----------
    stamps : array, shape (T,)
        In any unit.
    """
    stamps = np.asarray(stamps)
    if stamps.dtype.kind in 'iu':
        # Differences of short or unsigned numbers would go round.
        stamps = stamps.astype(np.int64)
    finite = stamps[np.isfinite(stamps)]
    if len(finite) > 1 and bool(np.all(finite == np.rint(finite))):
        middle = float(np.median(finite))
        interval = float(np.median(np.abs(np.diff(finite))))
        for per_second, unit in UNITS:
            counted = middle > YEAR_2001_S * per_second
            apart = per_second > 1e3 and interval > max(
                LONGEST_INTERVAL_S, SHORTEST_INTERVAL_S * per_second)
            if counted or apart:
                # The first is taken off before: a double holds no nanoseconds since 1970.
                first = finite[0]
                return float(first) / per_second + (stamps - first) / per_second, unit
    return stamps.astype(np.float64), 'seconds'


def median_interval(stamps: NDArray) -> float:
    """Return the median interval of stamps that differ, in their unit; 1 for a single one."""
    moments = np.unique(stamps)
    return float(np.median(np.diff(moments))) if len(moments) > 1 else 1.0


def increasing_frames(stamps: NDArray) -> NDArray[np.int64]:
    """Return the numbers of the most frames whose stamps increase strictly (patience sorting).

    Parameters
    ----------
    stamps : array, shape (T,)
        Seconds; those that are not finite are left out.
    """
    tails: list[int] = []
    before = np.full(len(stamps), -1)
    ends: list[float] = []
    for k in np.flatnonzero(np.isfinite(stamps)).tolist():
        stamp = float(stamps[k])
        place = bisect_left(ends, stamp)
        if place < len(ends) and stamp == ends[place]:
            # Of two equal stamps the second is the wrong one.
            continue
        before[k] = tails[place - 1] if place else -1
        tails[place:place + 1] = [k]
        ends[place:place + 1] = [stamp]
    chosen = []
    last = tails[-1] if tails else -1
    while last >= 0:
        chosen.append(last)
        last = int(before[last])
    return np.array(chosen[::-1], np.int64)


def pieces(stamps: NDArray, longest_pause_s: float | None = None,
           ) -> tuple[list[NDArray[np.int64]], list[str]]:
    """Return the frames whose stamps can be searched, cut at long pauses, and what was left out.

    A stamp that is not finite, repeats, or lies before one that most others agree with, is left
    out with its frame, and so are the few frames before or after a pause that make no batch.

    Parameters
    ----------
    stamps : array, shape (T,)
        Seconds.
    longest_pause_s : float, optional
        Longest pause within a piece; none unless given.

    Returns
    -------
    pieces : list of array of int
        Numbers of the frames of each piece.
    remarks : list of str
        A sentence for each thing that was done.
    """
    remarks = []
    kept = increasing_frames(stamps)
    if len(kept) < len(stamps):
        bad = np.setdiff1d(np.arange(len(stamps)), kept)
        remarks.append(
            f'{_frames(bad)} left out: stamp {stamps[bad[0]]:.10g} s is not after that of the '
            'frame before')
    if longest_pause_s is None or len(kept) < 2:
        return [kept], remarks
    at = np.flatnonzero(np.diff(stamps[kept]) > longest_pause_s)
    found = np.split(kept, at + 1)
    long_enough = [piece for piece in found if len(piece) >= SHORTEST_PIECE]
    for piece in found:
        if len(piece) < SHORTEST_PIECE and long_enough:
            remarks.append(f'{_frames(piece)} left out: beside a pause of more than '
                           f'{longest_pause_s:.3g} s')
    if len(long_enough) > 1:
        pauses = ', '.join(f'{stamps[b[0]] - stamps[a[-1]]:.3g} s before frame {b[0]}'
                           for a, b in zip(long_enough[:-1], long_enough[1:], strict=True))
        remarks.append(f'searched apart before and after pauses: {pauses}')
    return long_enough or found, remarks


def _frames(numbers: NDArray[np.int64]) -> str:
    """Return a few frame numbers in words."""
    if len(numbers) == 1:
        return f'frame {numbers[0]} is'
    shown = ', '.join(map(str, numbers[:5])) + (', …' if len(numbers) > 5 else '')
    return f'{len(numbers)} frames ({shown}) are'
