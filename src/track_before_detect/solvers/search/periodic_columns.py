"""Frames whose columns go round: bearing, and Doppler that is ambiguous.

The search, the fit and the refinement know plain frames alone, so they are given a strip that goes
on beyond the seam at both sides, by more than a target travels. A target near the seam is then
there twice, and one copy of it may run out of the strip; the copy that counts is the one that is
inside the frame in the middle of the batch, which is far from both ends of the strip all the time.

Doppler goes round as well, where it is ambiguous: a target as much faster as the columns span is
seen in the same column, and another row. Every such speed has columns of its own on the strip, so
how the row changes with the column holds throughout; but what a target explains in one column has
then to be taken off all others of the same Doppler, see the class ``WorkingSet``. Speeds by which
the rows of a batch differ by less than about one are mistaken for each other at times.

Motion over bearing is that of the plane of bearing and range: nearly constant velocity in bins per
second, with the acceleration bound in bins. A straight course past the sensor is a curve in this
plane; it is followed where that bound allows its apparent acceleration, speed^2 / range in range
bins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.models.measurement.base import MeasurementModel
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import EarlierPaths, FoundTrajectory


@dataclass(frozen=True)
class PeriodicColumns:
    """Columns that go round, or that end at both sides.

    Attributes
    ----------
    width : int
        Columns of the frames.
    margin : int
        Columns that the strip goes on for beyond the seam at each side; 0 where columns end.
    ambiguous : bool
        Whether a column of the strip is another speed than that of the frames: then each target
        is there once and explains something in all columns that show it.
    """

    width: int
    margin: int = 0
    ambiguous: bool = False

    @property
    def period(self) -> int | None:
        """Columns after which what a target explains comes again; None where it does not."""
        return self.width if self.ambiguous else None

    def strip(self, frames: NDArray) -> NDArray:
        """Return frames (..., W) that go on beyond the seam at both sides."""
        if not self.margin:
            return frames
        sides = [(0, 0)] * (frames.ndim - 1) + [(self.margin, self.margin)]
        return np.pad(frames, sides, mode='wrap')

    def plane(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the size (H, W) of the strip for frames of a size."""
        return shape[0], shape[1] + 2 * self.margin

    def on_strip(self, earlier: EarlierPaths | None) -> EarlierPaths | None:
        """Return paths of the frames as they are on the strip, in each place where one may be."""
        if earlier is None or not self.margin:
            return earlier
        n_turns = math.ceil(self.margin / self.width)
        places = []
        for path in earlier.positions:
            present = np.flatnonzero(np.isfinite(path[:, 0]))
            x = path[:, 0] + self.margin
            x[present] = np.unwrap(x[present], period=self.width)
            # The place in the frame first: a target is most often where it was seen.
            for turn in sorted(range(-n_turns, n_turns + 1), key=abs):
                places.append(np.column_stack([x + turn * self.width, path[:, 1]]))
        return replace(earlier, positions=places)

    def in_frame(self, found: Sequence[FoundTrajectory]) -> list[FoundTrajectory]:
        """Return the targets of a strip, each once, in columns from -0.5 to ``width`` - 0.5."""
        if not self.margin:
            return list(found)
        kept = []
        for trajectory in found:
            x = trajectory.positions[:, 0] - self.margin
            present = np.flatnonzero(np.isfinite(x))
            if self.ambiguous or -0.5 <= x[present[len(present) // 2]] < self.width - 0.5:
                positions = np.column_stack(
                    [(x + 0.5) % self.width - 0.5, trajectory.positions[:, 1]])
                kept.append(replace(trajectory, positions=positions))
        return kept


def doppler_columns(options: DetectorOptions, measurement: MeasurementModel,
                    width: int) -> PeriodicColumns:
    """Return the columns of range-Doppler maps, and of any frames whose columns end.

    Beside those of the ambiguities there is room for a stamp and a change of the Doppler.
    """
    if not options.doppler_ambiguities:
        return PeriodicColumns(width)
    _check_width('doppler_ambiguities', width, measurement)
    return PeriodicColumns(
        width, options.doppler_ambiguities * width + 2 * measurement.half_width, True)


def columns_of(options: DetectorOptions, measurement: MeasurementModel, width: int,
               graph: StateGraph) -> PeriodicColumns:
    """Return the columns of frames over which the paths of a graph are searched."""
    if options.motion_model != 'range_bearing':
        return doppler_columns(options, measurement, width)
    _check_width('motion_model range_bearing', width, measurement)
    travel = graph.step_px * np.abs(graph.end_moves[..., 0]).max(axis=1).sum()
    return PeriodicColumns(width, math.ceil(travel) + 2 * measurement.half_width)


def _check_width(name: str, width: int, measurement: MeasurementModel) -> None:
    """Refuse frames around which a stamp would meet itself."""
    least = 2 * measurement.half_width + 1
    if width < least:
        raise ParameterError(
            f'{name} needs frames with at least {least} columns, which the point spread function '
            f'covers, got {width}')
