"""What the suites ``ring-single`` and ``ring-multi`` share: shares by method, and times."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.quantities import estimate, Quantity
from track_before_detect.evaluation.engine.timing import timed
from track_before_detect.evaluation.studies.ring.scenes import SIDE_PX
from track_before_detect.solvers.ring.merit_functions import METHODS

ORDERS = ('cfo', 'cso', 'mff')
FORMS = ('dp', 'dpr')
# Frames that times are measured on, and how often; the least counts.
TIMED_FRAMES, _TIMED = 20, 3
COMMON = (f'Frames of {SIDE_PX} x {SIDE_PX} pixels, white noise of one pixel, targets '
          'of one pixel; SNR is the amplitude over the noise of a pixel. ')

ByMethod = Mapping[str, NDArray[np.float64]]


class Shares:
    """A share by case, length, SNR, run and method; statistics with intervals over the runs.

    Parameters
    ----------
    values : array, shape (C, L, S, R, M)
        Methods in the order of ``METHODS``.
    """

    def __init__(self, values: NDArray[np.float64]):
        self._by_run = np.moveaxis(values, 3, 0)

    def means(self) -> ByMethod:
        """Return the mean over runs by method, shape (C, L, S)."""
        return _by_method(self._by_run.mean(axis=0))

    def half_widths(self) -> ByMethod:
        """Return half of the 95 % interval of each mean, for pictures."""
        runs = len(self._by_run)
        spread = self._by_run.std(axis=0, ddof=1 if runs > 1 else 0)
        return _by_method(1.96 * spread / np.sqrt(runs))

    def quantity(self, name: str, statistic: Callable[[ByMethod], float], note: str = '',
                 unit: str = '%') -> Quantity:
        """Return a statistic of the means with its interval."""
        return estimate(name, self._by_run,
                        lambda drawn: float(statistic(_by_method(drawn.mean(axis=0)))), 'runs',
                        unit, note)

    def of(self, methods: Sequence[str], name: str, statistic: Callable[..., float],
           note: str = '', unit: str = '%') -> Quantity:
        """Return a statistic of the means of some methods, told one after the other."""
        return self.quantity(name, lambda p: statistic(*(p[method] for method in methods)), note,
                             unit)

    def of_rings(self, name: str, statistic: Callable[[NDArray, NDArray], float], note: str,
                 unit: str = '%') -> list[Quantity]:
        """Return a statistic of DP and DPR by order, for which ``name`` has a place."""
        return [self.of([f'{order}_{form}' for form in FORMS], name.format(order.upper()),
                        statistic, note, unit) for order in ORDERS]

    def gains_of_order(self, name: str, mean: Callable[[NDArray], float]) -> list[Quantity]:
        """Return how much more methods of a higher order have; ``name`` has a place for both."""
        pairs = [(f'{more}_{form}', f'{less}_{form}')
                 for form in FORMS for more, less in (('mff', 'cso'), ('cso', 'cfo'))]
        return [self.of(pair, name.format(' minus '.join(map(shown, pair))),
                        lambda more, less: mean(more - less), 'paper: above 0') for pair in pairs]


def shown(method: str) -> str:
    """Return the name of a method as the paper has it."""
    return method.replace('_', '-').upper()


def ms_per_frame(calls: Iterable[Callable[[], Any]]) -> str:
    """Return the least CPU times of calls on the timed frames, in ms per frame."""
    least = []
    for call in calls:
        call()
        least.append(timed([call], _TIMED)[0, :, 1].min())
    return '/'.join(f'{1e3 * seconds / TIMED_FRAMES:.2f}' for seconds in least)


def _by_method(values: NDArray) -> ByMethod:
    return {method: values[..., number] for number, method in enumerate(METHODS)}
