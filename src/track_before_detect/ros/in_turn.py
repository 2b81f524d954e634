"""Work done one after the other in a thread of its own, while the next is prepared.

No ROS types in here.
"""

from collections.abc import Callable
import threading


class InTurn:
    """Does what it is told in the order in which it is told.

    Beside what is being done no more than one piece of work waits. An error in one is raised from
    the next call; nothing is done after it.

    Parameters
    ----------
    name : str
        Of the thread.
    """

    def __init__(self, name: str) -> None:
        self._changed = threading.Condition()
        self._waiting: Callable[[], None] | None = None
        self._doing = self._closed = False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def busy(self) -> bool:
        """Whether anything is being done or waits."""
        return self._doing or self._waiting is not None

    def do(self, work: Callable[[], None]) -> None:
        """Have work done as soon as what was told before is; wait while something waits."""
        self.wait_until_begun()
        with self._changed:
            if self._closed:
                return
            if self._thread.ident is None:
                self._thread.start()
            self._waiting = work
            self._changed.notify_all()

    def wait_until_begun(self) -> None:
        """Wait until nothing waits."""
        self._wait_for(lambda: self._waiting is None)

    def wait_until_done(self) -> None:
        """Wait until nothing waits or is being done."""
        self._wait_for(lambda: not self.busy)

    def close(self) -> None:
        """Ask the thread to end with what it is doing, and let go of whoever waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of the thread; return whether it came in time."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or condition())
            if self._error is not None:
                raise self._error

    def _run(self) -> None:
        while True:
            with self._changed:
                self._doing = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or self._waiting is not None)
                work, self._waiting = self._waiting, None
                if self._closed or work is None:
                    return
                self._doing = True
                self._changed.notify_all()
            try:
                work()
            except BaseException as error:
                self._error = error
                self.close()
            # Not held until there is more to do.
            del work
