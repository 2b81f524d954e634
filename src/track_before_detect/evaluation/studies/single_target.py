"""Scenes with one target or none: what the studies dim, accuracy and false-alarms share.

White noise of standard deviation 1 and targets that are unit-norm Gaussian stamps of 1 px, so SNR
is the amplitude. The detector is the convex one with default options.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from track_before_detect.simulation.motions import centred_path
from track_before_detect.simulation.sensor import add_path
from track_before_detect.solvers.batch_detector import FoundTrajectory

N_FRAMES = 20
SIGMA_PX = 1.0
SPEEDS_PX = (0.2, 1.0)
RADIUS_PX = 20.0
# False alarms that thresholds are made for, where nothing else is said.
RATE = 0.05


def random_path(rng: np.random.Generator, motion: str) -> NDArray[np.float64]:
    """Return a ``line`` or an ``arc`` about the origin, shape (T, 2)."""
    heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(*SPEEDS_PX)
    turn = speed / RADIUS_PX * rng.choice((-1.0, 1.0)) if motion == 'arc' else 0.0
    return centred_path(heading, speed, turn, N_FRAMES)


def noise(rng: np.random.Generator, side_px: int,
          n_frames: int = N_FRAMES) -> NDArray[np.float32]:
    """Return square frames of noise."""
    return rng.standard_normal((n_frames, side_px, side_px), np.float32)


def frames_with(rng: np.random.Generator, side_px: int, path: NDArray, snr: float,
                sigma_px: float = SIGMA_PX) -> NDArray[np.float32]:
    """Return square frames of noise with a target."""
    frames = noise(rng, side_px)
    add_path(frames, path, sigma_px, snr)
    return frames


def mean_errors(found: Sequence[FoundTrajectory], truth: NDArray) -> list[float]:
    """Return how far each trajectory is from the target on average, in pixels."""
    return [float(np.linalg.norm(one.positions - truth, axis=1).mean()) for one in found]
