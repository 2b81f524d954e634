"""Work done one after the other in a thread of its own, while the next is prepared.

No ROS types in here.
"""

from collections.abc import Callable

from track_before_detect.parallel import OwnThread


class InTurn(OwnThread[Callable[[], None]]):
    """Does what it is told in the order in which it is told.

    Beside what is being done no more than one piece of work waits. An error in one is raised from
    the next call; nothing is done after it.

    Parameters
    ----------
    name : str
        Of the thread.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._doing = False
        self._error: BaseException | None = None

    @property
    def busy(self) -> bool:
        """Whether anything is being done or waits."""
        return self._doing or self.next is not None

    def do(self, work: Callable[[], None]) -> None:
        """Have work done as soon as what was told before is; wait while something waits."""
        self.wait_until_begun()
        self.hand_over(work)

    def wait_until_begun(self) -> None:
        """Wait until nothing waits."""
        self._wait_for(lambda: self.next is None)

    def wait_until_done(self) -> None:
        """Wait until nothing waits or is being done."""
        self._wait_for(lambda: not self.busy)

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            self.changed.wait_for(lambda: self.closed or condition())
            if self._error is not None:
                raise self._error

    def run(self) -> None:
        """Do what is handed over."""
        while True:
            with self.changed:
                self._doing = False
                self.changed.notify_all()
                work = self.take()
                if work is None:
                    return
                self._doing = True
                self.changed.notify_all()
            try:
                work()
            except BaseException as error:
                self._error = error
                self.close()
            # Not held until there is more to do.
            del work
