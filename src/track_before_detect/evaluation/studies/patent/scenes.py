"""Scenes of figures 2-7 of US application 18/790,866, as its text describes them.

One-dimensional frames, targets blurred by a Gaussian and white noise of unit variance. Where the
text leaves a number open it is chosen here, once.
"""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Figures 2-4: one frame.
SINGLE_SIGMA_PX = 3.0
PAIR_CENTRES_PX = (32.0, 96.0, 160.0)
PAIR_DISTANCES_PX = (9.0, 6.0, 3.0)
PAIR_SNR = 12.0
# Above, between and below where a second path pays and where greedy leaves a third
# (docs/constants/evaluation.md).
PAIR_SNRS = (30.0, 12.0, 6.0)
PAIR_DISTANCE_PX = 6.0
SEPARATE_SINGLE_SNRS = (14.0, 11.0, 8.0, 3.0)

# Figures 5-7: a batch, and one motion model for all of them.
SIGMA_PX = 2.0
N_FRAMES = 30
WIDTH_PX = 128
MAX_SPEED_PX = 0.5
MAX_ACCELERATION_PX = 0.01
DRIFT_PX = 0.2
SEPARATE_SNRS = (4.0, 3.0, 2.0, 1.0)
PARALLEL_PX = 5.0
PARALLEL_SNR = 4.0
CROSSING_SNRS = (3.0, 2.0)
CROSSING_PX = 0.5


class Scene(NamedTuple):
    """Targets on a line and what a sensor makes of them.

    Attributes
    ----------
    positions : array, shape (N, T)
        x in pixels.
    snrs : array, shape (N,)
        Amplitude of the unit-norm stamp.
    received : array, shape (T, W)
        Without noise.
    measured : float32 array, shape (T, 1, W)
        With noise of unit variance.
    """

    positions: NDArray[np.float64]
    snrs: NDArray[np.float64]
    received: NDArray[np.float64]
    measured: NDArray[np.float32]


def _scene(positions: ArrayLike, snrs: ArrayLike, sigma: float, width: int,
           rng: np.random.Generator) -> Scene:
    """Blur the targets and add noise."""
    positions, snrs = np.asarray(positions, float), np.asarray(snrs, float)
    offset = np.arange(width) - positions[:, :, None]
    # Samples of this Gaussian have unit norm; at sigma of two pixels the sum is an integral.
    stamps = np.exp(-offset**2 / (2 * sigma**2)) / math.sqrt(sigma * math.sqrt(math.pi))
    received = np.einsum('n,ntx->tx', snrs, stamps)
    noise = rng.standard_normal(received.shape)
    return Scene(positions, snrs, received, (received + noise).astype(np.float32)[:, None])


def separate_single(rng: np.random.Generator) -> Scene:
    """Draw Figure 2: four separate targets in one frame."""
    centres = 20.0 + 40.0 * np.arange(4) + rng.uniform(-0.5, 0.5, 4)
    return _scene(centres[:, None], SEPARATE_SINGLE_SNRS, SINGLE_SIGMA_PX, 160, rng)


def pairs_of_distances(rng: np.random.Generator) -> Scene:
    """Draw Figure 3: pairs of equal targets in one frame, closer and closer."""
    return _pairs(PAIR_DISTANCES_PX, [PAIR_SNR] * 3, rng)


def pairs_of_snrs(rng: np.random.Generator) -> Scene:
    """Draw Figure 4: pairs of equal targets in one frame, dimmer and dimmer."""
    return _pairs([PAIR_DISTANCE_PX] * 3, PAIR_SNRS, rng)


def _pairs(distances: Sequence[float], snrs: Sequence[float], rng: np.random.Generator) -> Scene:
    centres = np.array(PAIR_CENTRES_PX) + rng.uniform(-0.5, 0.5, 3)
    half = 0.5 * np.array(distances)
    positions = np.column_stack([centres - half, centres + half]).reshape(-1, 1)
    return _scene(positions, np.repeat(snrs, 2), SINGLE_SIGMA_PX, 192, rng)


def _time() -> NDArray:
    return np.arange(N_FRAMES) - 0.5 * (N_FRAMES - 1)


def _middle(rng: np.random.Generator) -> NDArray:
    """Return the middle of two targets, which drifts through that of the frames."""
    start = 0.5 * WIDTH_PX + rng.uniform(-0.5, 0.5)
    return start + rng.uniform(-DRIFT_PX, DRIFT_PX) * _time()


def separate(rng: np.random.Generator) -> Scene:
    """Draw Figure 5: four separate targets in a batch."""
    start = 16.0 + 32.0 * np.arange(4) + rng.uniform(-0.5, 0.5, 4)
    speed = rng.uniform(-DRIFT_PX, DRIFT_PX, 4)
    acceleration = rng.uniform(-MAX_ACCELERATION_PX, MAX_ACCELERATION_PX, 4)
    time = _time()
    positions = (start[:, None] + speed[:, None] * time
                 + 0.5 * acceleration[:, None] * (time**2 - np.mean(time**2)))
    return _scene(positions, SEPARATE_SNRS, SIGMA_PX, WIDTH_PX, rng)


def parallel(rng: np.random.Generator) -> Scene:
    """Draw Figure 6: two targets side by side."""
    middle = _middle(rng)
    positions = [middle - 0.5 * PARALLEL_PX, middle + 0.5 * PARALLEL_PX]
    return _scene(positions, [PARALLEL_SNR] * 2, SIGMA_PX, WIDTH_PX, rng)


def crossing(rng: np.random.Generator) -> Scene:
    """Draw Figure 7: two targets that cross."""
    middle = _middle(rng)
    apart = 0.5 * CROSSING_PX * _time()
    return _scene([middle + apart, middle - apart], CROSSING_SNRS, SIGMA_PX, WIDTH_PX, rng)
