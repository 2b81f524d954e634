"""What is known of the targets of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Columns of a row of labels.
FRAME, ID, X, Y, WIDTH, HEIGHT = range(6)


@dataclass(frozen=True)
class Other:
    """Something that is really there and has no label: finding it is neither right nor wrong.

    Attributes
    ----------
    what : str
        In words.
    waypoints : tuple of (frame, x, y)
        Where it is in some frames, in pixels; in straight lines between them, and not there
        before the first and after the last.
    half_size_px : tuple of float
        How far from there it still is along rows and along columns.
    """

    what: str
    waypoints: tuple[tuple[float, float, float], ...]
    half_size_px: tuple[float, float]

    def places(self, n_frames: int) -> NDArray[np.float64]:
        """Return where it is in the frames of a recording, shape (T, 2); NaN where it is not."""
        frames, x, y = np.array(self.waypoints, float).T
        index = np.arange(n_frames)
        return np.column_stack([np.interp(index, frames, along, np.nan, np.nan)
                                for along in (x, y)])

    def holds(self, positions: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return in which frames positions (..., T, 2), NaN where absent, are at this thing."""
        apart = np.abs(positions - self.places(positions.shape[-2]))
        return np.asarray(np.all(apart <= self.half_size_px, axis=-1))


@dataclass(frozen=True)
class Truth:
    """The targets of a recording.

    Attributes
    ----------
    labels : array, shape (N, 6)
        Rows [frame, id, x, y, width, height] in pixels, x and y of the centre; width and height
        are 0 of a target that is labelled as a point.
    known : array of bool, shape (T,)
        Frames whose targets are all labelled, those of ``others`` aside.
    pixels : array of int, shape (M, 4)
        Rows [frame, id, x, y]: the pixels that are part of a target.
    others : tuple of Other
        What else is there.
    """

    labels: NDArray[np.float64]
    known: NDArray[np.bool_]
    pixels: NDArray[np.int64]
    others: tuple[Other, ...] = ()

    @classmethod
    def of_labels(cls, labels: NDArray, n_frames: int, *, known: NDArray[np.bool_] | None = None,
                  pixels: NDArray | None = None, others: Sequence[Other] = ()) -> Truth:
        """Return the truth that labels tell.

        Parameters
        ----------
        labels : array, shape (N, 6)
            As of the class.
        n_frames : int
            Frames of the recording.
        known : array of bool, shape (T,), optional
            As of the class; unless given, nothing is known of frames without a label.
        pixels : array of int, shape (M, 4), optional
            As of the class; unless given, the pixels whose centres a box covers, and the nearest
            one of a point.
        others : sequence of Other
            What else is there.
        """
        labels = np.asarray(labels, float).reshape(-1, 6)
        if known is None:
            known = np.zeros(n_frames, bool)
            known[labels[:, FRAME].astype(int)] = True
        if pixels is None:
            rows = [_covered(label) for label in labels]
            pixels = np.concatenate(rows) if rows else np.zeros((0, 4))
        return cls(labels, known, np.asarray(pixels, np.int64), tuple(others))


def _covered(label: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pixels of one label."""
    sides = []
    for centre, size in ((label[X], label[WIDTH]), (label[Y], label[HEIGHT])):
        side = np.arange(np.ceil(centre - size / 2), np.floor(centre + size / 2) + 1)
        sides.append(side if len(side) else np.array([np.rint(centre)]))
    x, y = np.meshgrid(*sides)
    frame_and_id = np.broadcast_to(label[[FRAME, ID]], (x.size, 2))
    return np.column_stack([frame_and_id, x.ravel(), y.ravel()]).astype(np.int64)
