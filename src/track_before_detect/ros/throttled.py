"""What is said at most once in a while, and nothing of it lost."""

from collections.abc import Callable
import threading
import time
from typing import Generic, TypeVar

Item = TypeVar('Item')


class Throttled(Generic[Item]):
    """Hands items on at once, but what comes too soon only when the time for it has come.

    Parameters
    ----------
    say : callable
        Takes the items since the last time, oldest first.
    period_s : float
        From one call of ``say`` to the next.
    """

    def __init__(self, say: Callable[[list[Item]], None], period_s: float):
        self._say = say
        self._period_s = period_s
        self._lock = threading.Lock()
        self._items: list[Item] = []
        self._said_s = -float('inf')

    def put(self, item: Item, at_once: bool = False) -> bool:
        """Add an item; return whether it was handed on."""
        with self._lock:
            self._items.append(item)
        return self.tick(at_once)

    def tick(self, at_once: bool = False) -> bool:
        """Hand on what waits if it is time; return whether something was; to be called often."""
        with self._lock:
            now_s = time.monotonic()
            if not self._items or not (at_once or now_s - self._said_s >= self._period_s):
                return False
            items, self._items, self._said_s = self._items, [], now_s
        self._say(items)
        return True
