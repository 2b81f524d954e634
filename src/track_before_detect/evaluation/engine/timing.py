"""Times of work that takes turns."""

from collections.abc import Callable, Mapping, Sequence
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray


def timed(stages: Sequence[Callable[[], Any]], repeats: int) -> NDArray[np.float64]:
    """Return wall and CPU seconds of stages, shape (stages, repeats, 2).

    They take turns, so that whatever else the machine does falls on all of them alike.
    """
    seconds = np.empty((len(stages), repeats, 2))
    for repeat in range(repeats):
        for number, stage in enumerate(stages):
            wall, cpu = time.perf_counter(), time.process_time()
            stage()
            seconds[number, repeat] = time.perf_counter() - wall, time.process_time() - cpu
    return seconds


def summary(seconds: NDArray) -> dict[str, dict[str, float]]:
    """Return least and median of wall and CPU seconds, given in shape (repeats, 2)."""
    return {clock: {'min': float(seconds[:, column].min()),
                    'median': float(np.median(seconds[:, column]))}
            for column, clock in enumerate(('wall_s', 'cpu_s'))}


def in_ms(times: Mapping[str, float], digits: int) -> str:
    """Return one clock of :func:`summary` as text: the least in ms, the median in brackets."""
    return f'{1e3 * times["min"]:.{digits}f} ({1e3 * times["median"]:.{digits}f})'
