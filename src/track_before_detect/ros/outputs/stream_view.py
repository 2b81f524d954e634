"""What ``tbd view`` shows, of a stream while it is searched."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
import math
from pathlib import Path
import time
from typing import Any

from track_before_detect.cli.console import check_output_file, require_extra
from track_before_detect.errors import ParameterError
from track_before_detect.inspection.live_view import LiveView
from track_before_detect.inspection.view_outlets import new_stream, saved, served
from track_before_detect.parallel import OwnThread
from track_before_detect.ros.parameters import NodeParameter
from track_before_detect.ros.search_results import StreamResult
from track_before_detect.tracking.pipeline import Searched
from track_before_detect.types import FrameBatch

# From one batch shown to the next where the search is late, so that it keeps the processor.
LATE_PERIOD_S = 2.0
WEB, SUFFIX = 'web', '.rrd'
VIEW = NodeParameter(
    'view', '', 'Where to show what tbd view shows, while it is searched (extra [view]): web is a '
    'page that this machine alone can reach, whose address is logged, a path that ends with '
    f'{SUFFIX} a file, which is replaced. Empty shows nothing.', 'text')


def check_view(values: Mapping[str, Any]) -> None:
    """Raise ParameterError where what the parameters ask to show cannot be shown."""
    where = values['view']
    if where in ('', WEB):
        return
    if not where.endswith(SUFFIX):
        raise ParameterError(f'view must be {WEB} or end with {SUFFIX}, got {where!r}')
    check_output_file(Path(where), SUFFIX, name='view')


class StreamView(OwnThread[tuple[list[Searched], StreamResult]]):
    """Shows batches in a thread of its own, the newest of those that wait.

    Parameters
    ----------
    where : str
        Of the parameter ``view``, not empty.
    on_open : callable
        Takes where it is shown, as text; runs in the thread, like the next.
    on_warning : callable
        Takes a kind, for throttling, and a sentence.
    """

    def __init__(self, where: str, on_open: Callable[[str], None],
                 on_warning: Callable[[str, str], None]):
        super().__init__('view')
        self._where = where
        self._on_open = on_open
        self._on_warning = on_warning
        self._searched: list[Searched] = []
        self._n_left_out = 0
        self._shown_s = -math.inf

    def start(self) -> None:
        """Open the page or the file, which takes seconds, in the thread."""
        self._thread.start()

    def observe(self, searched: Searched) -> None:
        """Keep what is known of the batch that is being searched beside one background."""
        self._searched = [*self._of(searched.batch), searched]

    def show(self, result: StreamResult, is_late: bool = False) -> None:
        """Have a batch shown, now and then where the search is late; nothing waits for that."""
        leaves_out = is_late and time.monotonic() - self._shown_s < LATE_PERIOD_S
        if not leaves_out:
            self._shown_s = time.monotonic()
            with self.changed:
                leaves_out = self.next is not None
                self.hand_over((self._of(result.batch), result))
        self._searched = []
        if leaves_out:
            self._n_left_out += 1
            self._on_warning('left out', f'{self._n_left_out} batches were not shown so far in '
                             'the view, which gives way to the search')

    def run(self) -> None:
        """Show what is handed over."""
        try:
            require_extra('rerun', 'view', 'it')
            stream = new_stream()
            with ExitStack() as opened:
                if self._where == WEB:
                    self._on_open(opened.enter_context(served(stream)))
                else:
                    opened.enter_context(saved(stream, Path(self._where)))
                    self._on_open(self._where)
                view = LiveView(stream)
                while self._show_next(view):
                    # Waits until it is there, so that nothing gathers here.
                    stream.flush()
        except Exception as error:
            self.close()
            self._on_warning('view', f'the node goes on without view: {error}')

    def _show_next(self, view: LiveView) -> bool:
        """Show a batch as soon as there is one; return whether there was."""
        if (taken := self.take()) is None:
            return False
        searched, result = taken
        for one in searched:
            view(one)
        view.show_trajectories(result.detection.trajectories, result.batch.frame_indices.tolist(),
                               result.batch.stamps.tolist())
        return True

    def _of(self, batch: FrameBatch) -> list[Searched]:
        """Return what was kept of a batch; a search that failed may have left more."""
        return [one for one in self._searched if one.batch is batch]
