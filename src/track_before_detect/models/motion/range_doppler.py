"""Paths over range-Doppler maps, whose Doppler column says how fast the range changes."""

import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.motion.coupling import RangeDopplerCoupling, whole_steps
from track_before_detect.models.motion.state_graph import StateGraph, STEPS_PER_SEGMENT


def build_range_doppler_graph(stamps: NDArray, *, step_px: float, rows_per_column: float,
                              still_column: float, max_acceleration: float,
                              turn_cost: float) -> StateGraph:
    """Discretise motion whose range rate is observed.

    The velocities of the graph are (rate of the Doppler column, range rate beside that of the
    column): the first lets the Doppler change, the second is there where half a grid step of
    Doppler would move the range too far off over a segment.

    Parameters
    ----------
    stamps, step_px
        As of ``build_state_graph``, stamps strictly increasing.
    rows_per_column : float
        Range bins per unit of time for each Doppler bin.
    still_column : float
        Column of targets whose range does not change.
    max_acceleration : float
        Range bins per unit of time squared.
    turn_cost : float
        Cost of a change of the Doppler rate by one step between two segments.
    """
    n_frames = len(stamps)
    interval = float(np.median(np.diff(stamps))) if n_frames > 1 else 1.0
    times = np.asarray(stamps, float) - 0.5 * (stamps[0] + stamps[-1])
    span = float(stamps[-1] - stamps[0]) + interval
    k = rows_per_column
    most_rate = max_acceleration / abs(k) if n_frames > 1 else 0.0
    room = STEPS_PER_SEGMENT * step_px
    duration = _longest(most_rate, k, room, span)
    n_segments = min(max(1, round(span / max(duration, interval))), n_frames)
    starts = stamps[0] + span / n_segments * np.arange(n_segments)
    knots = np.unique(np.append(
        np.searchsorted(stamps, starts - 1e-6 * interval), n_frames))
    n_segments = len(knots) - 1
    length = span / n_segments
    rate_step = room / max(length, 0.5 * abs(k) * length**2)
    extent = math.ceil(most_rate / rate_step - 1e-9)
    rates = np.arange(-extent, extent + 1) * (most_rate / extent if extent else 0.0)
    # A column of the grid stands for all Doppler within half a step.
    spread = abs(k) * step_px
    n_beside = max(1, round(spread * length / room)) if n_frames > 1 else 1
    beside = (np.arange(n_beside) - 0.5 * (n_beside - 1)) * spread / n_beside
    velocities = np.array([(rate, extra) for extra in beside for rate in rates])
    row_first = np.arange(n_beside + 1, dtype=np.int32) * np.int32(len(rates))
    row_x = np.zeros(n_beside, np.int32)

    ends = np.append(stamps, stamps[-1] + interval)
    moves = np.zeros((n_frames, len(velocities), 2), np.int32)
    end_moves = np.zeros((n_segments, len(velocities), 2), np.int32)

    def displacement(start: int, end: int) -> NDArray[np.int32]:
        """From the time ``start`` of a segment to ``end``, in grid steps of the sheared plane."""
        elapsed = ends[end] - ends[start]
        tau = ends[end] - 0.5 * (stamps[0] + stamps[-1])
        across = whole_steps(elapsed * velocities[:, 0] / step_px)
        rows = 0.5 * k * velocities[:, 0] * elapsed**2 + velocities[:, 1] * elapsed
        # The column is rounded; the shear has to be taken off as it is put on again.
        down = whole_steps(rows / step_px - k * tau * across)
        return np.stack([across, down], axis=1)

    for j in range(n_segments):
        for t in range(knots[j], knots[j + 1]):
            moves[t] = displacement(knots[j], t)
        end_moves[j] = displacement(knots[j], knots[j + 1])
    return StateGraph(
        step_px, knots, velocities, rate_step, min(1, len(rates) - 1) if n_segments > 1 else 1,
        row_first, row_x, moves, end_moves, float(turn_cost), math.inf,
        RangeDopplerCoupling(k, still_column, times))


def _longest(rate: float, k: float, room: float, span: float) -> float:
    """Return the longest time over which the largest Doppler rate moves a target by ``room``."""
    if not rate > 0:
        return span
    return min(room / rate, math.sqrt(2 * room / (abs(k) * rate)), span)
