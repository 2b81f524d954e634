"""The tiles of large frames.

A tile is a core, of which the cores of all tiles together make the frame, and a margin around it
that is searched, too. A target belongs to the tile in whose core it is in the middle of the batch.
The margin is as wide as the fastest target may go from there on to either end of the batch, and
one that it meets there from there to the other end, and two of the point spread function. So a
tile holds the whole path of each target that belongs to it, and of each that overlaps it.
"""

from dataclasses import dataclass
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import searched_speed


@dataclass(frozen=True)
class Tile:
    """A part of a frame, in pixels x, y.

    Attributes
    ----------
    core_begin, core_end : array, shape (2,)
        The half-open rectangle of the middles of targets that belong to it; without end where it
        is that of the frame.
    begin, end : array of int, shape (2,)
        The pixels that are searched.
    """

    core_begin: NDArray[np.float64]
    core_end: NDArray[np.float64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]

    def of(self, frames: NDArray) -> NDArray:
        """Return what frames (T, H, W) show of it."""
        return frames[:, self.begin[1]:self.end[1], self.begin[0]:self.end[0]]

    def depth(self, positions: NDArray) -> NDArray[np.float64]:
        """Return how far inside the core positions (..., 2) are, below zero where outside."""
        return np.minimum(positions - self.core_begin, self.core_end - positions).min(axis=-1)


def margin_px(options: DetectorOptions, stamps: NDArray, shape: tuple[int, int],
              measurement: MeasurementModel) -> int:
    """Return how far around its core a tile of frames (H, W) is searched."""
    crossed = searched_speed(options, stamps, shape) * float(np.ptp(stamps))
    # A target that is not there all the time may be seen at one end only.
    share = 1.5 if options.presence == 'full' else 2.0
    return math.ceil(share * crossed) + 2 * measurement.half_width


def tile_shape(options: DetectorOptions, stamps: NDArray, shape: tuple[int, int],
               measurement: MeasurementModel) -> tuple[int, int]:
    """Return (H, W) of what is searched at a time of frames (H, W): a tile, if there are any."""
    if options.tile_px is None:
        return shape
    margin = margin_px(options, stamps, shape, measurement)
    rows, columns = (min(length, math.ceil(length / -(-length // options.tile_px)) + 2 * margin)
                     for length in shape)
    return rows, columns


def tiles_of(options: DetectorOptions, stamps: NDArray, shape: tuple[int, int],
             measurement: MeasurementModel) -> list[Tile]:
    """Return the tiles of frames (H, W), all of one size, row by row."""
    margin = margin_px(options, stamps, shape, measurement)
    assert options.tile_px is not None
    axes = []
    for length, searched in zip(shape, tile_shape(options, stamps, shape, measurement),
                                strict=True):
        # What is as large as the frame needs no other beside it.
        n_tiles = -(-length // options.tile_px) if searched < length else 1
        edges = np.linspace(0, length, n_tiles + 1).round()
        begin = np.clip(edges[:-1] - margin, 0, length - searched).astype(int)
        # Pixels reach half a pixel to either side of their middle.
        edges = np.concatenate([[-np.inf], edges[1:-1] - 0.5, [np.inf]])
        axes.append(list(zip(edges, edges[1:], begin, begin + searched, strict=False)))
    return [Tile(*(np.array([along_x, along_y])
                   for along_x, along_y in zip(column, row, strict=True)))
            for row, column in itertools.product(*axes)]
