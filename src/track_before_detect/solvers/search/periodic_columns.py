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

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.batch_detector import FoundTrajectory


def doppler_margin(n_ambiguities: int, width: int, psf: Psf) -> int:
    """Return the columns that range-Doppler maps go on for at each side.

    Beside those of the ambiguities there is room for a stamp and a change of the Doppler.
    """
    if n_ambiguities == 0:
        return 0
    _check_width('doppler_ambiguities', width, psf)
    return n_ambiguities * width + 2 * psf.half_width


def strip_margin(graph: StateGraph, width: int, psf: Psf) -> int:
    """Return the columns that are repeated at each side."""
    _check_width('motion_model range_bearing', width, psf)
    travel = graph.step_px * np.abs(graph.end_moves[..., 0]).max(axis=1).sum()
    return math.ceil(travel) + 2 * psf.half_width


def _check_width(name, width, psf):
    """Refuse frames around which a stamp would meet itself."""
    least = 2 * psf.half_width + 1
    if width < least:
        raise ParameterError(
            f'{name} needs frames with at least {least} columns, which the point spread function '
            f'covers, got {width}')


def strip(frames: NDArray, margin: int) -> NDArray:
    """Return frames (..., W) that go on for ``margin`` columns beyond the seam at both sides."""
    if margin == 0:
        return frames
    width = [(0, 0)] * (frames.ndim - 1)
    return np.pad(frames, [*width, (margin, margin)], mode='wrap')


def once_each(found: Sequence[FoundTrajectory], margin: int, width: int) -> list[FoundTrajectory]:
    """Return each target of a strip once, in columns from -0.5 to ``width`` - 0.5."""
    kept = []
    for trajectory in found:
        x = trajectory.positions[:, 0] - margin
        present = np.flatnonzero(np.isfinite(x))
        if -0.5 <= x[present[len(present) // 2]] < width - 0.5:
            kept.append(trajectory)
    return in_frame(kept, margin, width)


def in_frame(found: Sequence[FoundTrajectory], margin: int,
             width: int) -> list[FoundTrajectory]:
    """Return all trajectories of a strip in columns from -0.5 to ``width`` - 0.5."""
    return [dataclasses.replace(trajectory, positions=np.column_stack([
        (trajectory.positions[:, 0] - margin + 0.5) % width - 0.5, trajectory.positions[:, 1]]))
        for trajectory in found]
