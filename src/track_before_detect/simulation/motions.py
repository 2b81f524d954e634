"""How targets move in a scenario, and where they are put."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.errors import ParameterError

if TYPE_CHECKING:
    from track_before_detect.simulation.scenarios import Scenario

_MAX_TRIES = 5000


def place_targets(name: str, scenario: Scenario,
                  rng: np.random.Generator) -> NDArray[np.float64]:
    """Return positions (N, T, 2) as x, y inside the frame and far enough apart."""
    low = np.full(2, scenario.border_px)
    high = np.array([scenario.width, scenario.height]) - 1 - scenario.border_px
    together = scenario.motion in ('crossing', 'parallel')
    draw = _MOTIONS[scenario.motion]
    placed: list[NDArray] = []
    tries = 0
    while len(placed) < scenario.n_targets:
        tries += 1
        if tries > _MAX_TRIES:
            raise ParameterError(
                f'scenario {name} cannot place {scenario.n_targets} targets in '
                f'{scenario.height} x {scenario.width} px over {scenario.n_frames} frames; make '
                'the frames larger or the targets fewer or slower')
        paths = draw(scenario, rng)
        # A path is drawn about the origin, then put where it fits.
        room_low = low - paths.min(axis=(0, 1))
        room_high = high - paths.max(axis=(0, 1))
        if (room_low > room_high).any():
            continue
        if scenario.motion == 'range_doppler':
            # Its columns say how fast it moves.
            if scenario.doppler_ambiguities:
                room_low[0] = -scenario.doppler_ambiguities * scenario.width - paths[..., 0].min()
                room_high[0] = ((1 + scenario.doppler_ambiguities) * scenario.width - 1
                                - paths[..., 0].max())
            if not room_low[0] <= 0 <= room_high[0]:
                continue
            room_low[0] = room_high[0] = 0.0
        paths = paths + rng.uniform(room_low, room_high)
        if together:
            return paths
        if all(np.hypot(*(paths[0] - other).T).min() >= scenario.separation_px
               for other in placed):
            placed.append(paths[0])
    return np.array(placed).reshape(-1, scenario.n_frames, 2)


def direction(angle: ArrayLike) -> NDArray[np.float64]:
    """Return unit vectors x, y, shape (..., 2), of headings from x towards y in radians."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def centred_path(heading: float, speed_px: float, turn_rad: float,
                 n_frames: int) -> NDArray[np.float64]:
    """Return a path about its mean, shape (T, 2), at constant speed and turn for each frame."""
    path = np.cumsum(speed_px * direction(heading + turn_rad * np.arange(n_frames)), axis=0)
    return path - path.mean(axis=0)


def _turning_path(scenario: Scenario, rng: np.random.Generator, speed: float,
                  turn_rate: float) -> NDArray[np.float64]:
    """Return positions (1, T, 2) with constant speed and turn rate, from the origin."""
    k = np.arange(scenario.n_frames)[:, None]
    heading = rng.uniform(0, 2 * np.pi)
    if abs(turn_rate) < 1e-9:
        return (speed * k * direction(heading))[None]
    # The integral of speed * (cos, sin) of a heading that grows with the turn rate.
    angle = heading + turn_rate * k[:, 0]
    offset = direction(angle - np.pi / 2) - direction(heading - np.pi / 2)
    return (speed / turn_rate * offset)[None]


def _draw_line(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    return _turning_path(scenario, rng, rng.uniform(0.0, scenario.speed_px_per_frame), 0.0)


def _draw_turn(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    limit = scenario.turn_rate_rad_per_frame
    speed = rng.uniform(0.0, scenario.speed_px_per_frame)
    return _turning_path(scenario, rng, speed, rng.uniform(-limit, limit))


def _draw_arc(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    turn_rate = rng.choice((-1.0, 1.0)) * scenario.speed_px_per_frame / scenario.radius_px
    return _turning_path(scenario, rng, scenario.speed_px_per_frame, turn_rate)


def _draw_crossing(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    k = np.arange(scenario.n_frames) - 0.5 * (scenario.n_frames - 1)
    heading = rng.uniform(0, 2 * np.pi)
    velocities = scenario.speed_px_per_frame * direction(np.array([heading, heading + np.pi / 2]))
    return velocities[:, None, :] * k[None, :, None]


def _draw_parallel(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    heading = rng.uniform(0, 2 * np.pi)
    k = np.arange(scenario.n_frames)[:, None]
    path = scenario.speed_px_per_frame * k * direction(heading)
    return np.array([path, path + scenario.separation_px * direction(heading + np.pi / 2)])


def _draw_range_doppler(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    seconds = (np.arange(scenario.n_frames) - 0.5 * (scenario.n_frames - 1)) / scenario.fps
    rows_per_column = scenario.range_bins_per_doppler_bin
    fastest = scenario.speed_px_per_frame * scenario.fps
    if rows_per_column == 0:
        raise ParameterError('range_bins_per_doppler_bin must not be 0 for motion range_doppler')
    drift = rng.uniform(-0.5, 0.5) * scenario.doppler_drift_bins
    column_rate = drift / max(seconds[-1], 1e-9)
    # The speed is largest at one end of the recording, and holds for rows and columns together.
    room = math.sqrt(max(fastest**2 - column_rate**2, 0.0)) - abs(rows_per_column * drift)
    column = rng.uniform(-1.0, 1.0) * max(room, 0.0) / rows_per_column
    rows = rows_per_column * (column * seconds + 0.5 * column_rate * seconds**2)
    columns = scenario.width // 2 + column + column_rate * seconds
    return np.stack([columns, rows], axis=1)[None]


_MOTIONS: dict[str, Callable[[Scenario, np.random.Generator], NDArray]] = {
    'lines': _draw_line, 'turns': _draw_turn, 'arc': _draw_arc, 'crossing': _draw_crossing,
    'parallel': _draw_parallel, 'range_doppler': _draw_range_doppler,
}
