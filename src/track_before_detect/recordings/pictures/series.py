"""Frames that are files of their own, all alike."""

from collections.abc import Callable

from numpy.typing import NDArray

from track_before_detect.recordings.recording import check_like


class FileSeries:
    """Reads one file per frame and refuses one that is not like the first.

    Parameters
    ----------
    read_file : callable
        Returns the frame of a number, shape (H, W).
    name_of : callable
        Names the frame of a number in an error.
    adapt : callable, optional
        Turns a frame into the type of the first where nothing is lost by it.
    """

    def __init__(self, read_file: Callable[[int], NDArray], name_of: Callable[[int], str],
                 adapt: Callable[[NDArray, NDArray], NDArray] = lambda frame, first: frame):
        self._read_file = read_file
        self._name_of = name_of
        self._adapt = adapt
        self._first: NDArray | None = None

    def read(self, index: int) -> NDArray:
        """Return a frame."""
        frame = self._read_file(index)
        if self._first is None:
            self._first = frame
        frame = self._adapt(frame, self._first)
        check_like(self._name_of(index), frame, self._first.shape, self._first.dtype)
        return frame

    def close(self) -> None:
        """Do nothing: each file is closed when it was read."""
