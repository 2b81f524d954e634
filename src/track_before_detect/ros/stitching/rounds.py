"""Which batches of several regions belong together. No ROS types in here."""

from collections import deque
from collections.abc import Iterator
import math
from typing import Any, NamedTuple


class RegionBatch(NamedTuple):
    """One batch of one region.

    Attributes
    ----------
    stamp_s : float
        Of its newest frame.
    hop_s : float
        Since that of the batch before, 0 of the first.
    arrival_s : float
        By a clock that never jumps.
    content : object
        What was found.
    """

    stamp_s: float
    hop_s: float
    arrival_s: float
    content: Any


class Rounds:
    """Brings together batches that end within half a hop of each other, waiting so long.

    A region of which nothing came while a batch waited for it is silent, and not waited for again
    until it is heard.

    Parameters
    ----------
    n_regions : int
    wait_s : float
        Longest time that a batch waits for those of other regions.

    Attributes
    ----------
    silent : set of int
        Regions.
    n_late : list of int
        Batches of each region that came after their round, and were left out.
    """

    def __init__(self, n_regions: int, wait_s: float) -> None:
        self.silent: set[int] = set()
        self.n_late = [0] * n_regions
        self._wait_s = wait_s
        self._waiting: list[deque[RegionBatch]] = [deque() for _ in range(n_regions)]
        self._last_s = [math.nan] * n_regions
        self._heard_s = [-math.inf] * n_regions
        self._done_s = -math.inf

    def put(self, region: int, stamp_s: float, content: Any, now_s: float) -> bool:
        """Take a batch; return whether time went back, so that another stream begins."""
        began_anew = stamp_s < self._last_s[region]
        if began_anew:
            for waiting in self._waiting:
                waiting.clear()
            self._last_s = [math.nan] * len(self._waiting)
            self._done_s = -math.inf
        hop_s = stamp_s - self._last_s[region]
        self._last_s[region] = stamp_s
        self._heard_s[region] = now_s
        self.silent.discard(region)
        if stamp_s <= self._done_s:
            self.n_late[region] += 1
        else:
            self._waiting[region].append(RegionBatch(
                stamp_s, 0.0 if math.isnan(hop_s) else hop_s, now_s, content))
        return began_anew

    def take(self, now_s: float) -> Iterator[dict[int, RegionBatch]]:
        """Yield the rounds that are complete, or have waited long enough: batches by region."""
        while True:
            first = {region: waiting[0] for region, waiting in enumerate(self._waiting) if waiting}
            if not first:
                return
            missing = set(range(len(self._waiting))) - first.keys()
            since_s = min(one.arrival_s for one in first.values())
            if now_s - since_s >= self._wait_s:
                # One that is slow costs no more than the batches that have waited so long.
                self.silent |= {region for region in missing if self._heard_s[region] < since_s}
            elif missing - self.silent:
                return
            earliest = min(first.values(), key=lambda one: one.stamp_s)
            together = {region: one for region, one in first.items()
                        if one.stamp_s - earliest.stamp_s <= 0.5 * min(one.hop_s, earliest.hop_s)}
            for region in together:
                self._waiting[region].popleft()
            self._done_s = max(one.stamp_s for one in together.values())
            yield together
