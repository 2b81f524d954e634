"""Scenes of Guo, Li, Son and Fu 2018 (Parallel computing based dynamic programming).

Point targets, one cell each, of constant amplitude and uniform phase in complex Gaussian noise of
unit variance (Eq. 7); the SNR is 10 log10(A^2 / sigma^2) (Eq. 15). Six frames of 50 x 50 cells,
one second apart. The state of a target is (x, its velocity, y, its velocity) in cells and cells
per second.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.solvers.calibration.noise_study import noise_frames

N_FRAMES = 6
SHAPE = (50, 50)
# Section 4.2: targets 1 and 2 cross, 4 and 5 move side by side, 3 and 6 are on their own.
SIX_STATES = (
    (13.1, 1.0, 30.8, 0.9), (20.1, -1.0, 30.8, 1.0), (10.1, 1.0, 10.8, 0.9),
    (30.1, 1.0, 10.8, 0.0), (30.1, 1.0, 8.2, 0.0), (35.1, -0.9, 35.8, 1.0),
)
# Options of the detectors mt_dp and pc_dp for these scenes: a PSF this narrow is one cell.
OPTIONS: dict[str, Any] = {'psf_sigma_px': 0.3, 'max_speed_px_s': 1.0, 'amplitudes': 'complex'}


@dataclass(frozen=True)
class ParallelScene:
    """Frames and the targets in them.

    Attributes
    ----------
    frames : complex64 array, shape (T, H, W)
        Noise with E|n|^2 = 1, and targets.
    positions : array, shape (N, T, 2)
        x and y in cells, as the motion has them.
    cells : array of int, shape (N, T, 2)
        x and y of the cell each target is in.
    """

    frames: NDArray[np.complex64]
    positions: NDArray[np.float64]
    cells: NDArray[np.int64]


def six_targets(snr_db: float, rng: np.random.Generator,
                intensity: float = 0.0) -> ParallelScene:
    """Draw the scene of section 4.2, Fig. 6: six targets, the subject of Fig. 7-10.

    Parameters
    ----------
    snr_db : float
        8 in Fig. 7 and 8, 4 to 15 in Fig. 9 and 10.
    rng : numpy.random.Generator
        Noise, phases and motion.
    intensity : float
        q_1 of the process noise (Eq. 4), cells^2 / s^3. The text does not give it; with none the
        targets move as drawn in Fig. 6.
    """
    return draw_scene(SIX_STATES, snr_db, rng, intensity=intensity)


def many_targets(n_targets: int, snr_db: float, rng: np.random.Generator,
                 shape: tuple[int, int] = (512, 512)) -> ParallelScene:
    """Draw targets anywhere, in all directions, at speeds up to one cell per second in x and y."""
    height, width = shape
    margin = N_FRAMES
    states = [(rng.uniform(margin, width - 1 - margin), rng.uniform(-1, 1),
               rng.uniform(margin, height - 1 - margin), rng.uniform(-1, 1))
              for _ in range(n_targets)]
    return draw_scene(states, snr_db, rng, shape)


def draw_scene(states: Sequence[Sequence[float]], snr_db: float, rng: np.random.Generator,
               shape: tuple[int, int] = SHAPE, intensity: float = 0.0) -> ParallelScene:
    """Draw targets with given states in the first frame.

    Parameters
    ----------
    states : sequence of (x, velocity, y, velocity)
        In cells and cells per second.
    snr_db : float
        10 log10 of the squared amplitude over the variance of the noise.
    rng : numpy.random.Generator
        Noise, phases and motion.
    shape : tuple of int
        (H, W).
    intensity : float
        q_1 of the process noise.
    """
    frames = noise_frames(rng, (N_FRAMES, *shape), True)
    positions = moved(np.array(states, float), rng, intensity)
    cells = np.rint(positions).astype(int)
    amplitude = 10**(snr_db / 20)
    phases = rng.uniform(0, 2 * np.pi, cells.shape[:2])
    inside = np.all((cells >= 0) & (cells < (shape[1], shape[0])), axis=2)
    target, t = np.nonzero(inside)
    x, y = cells[target, t].T
    np.add.at(frames, (t, y, x),
              (amplitude * np.exp(1j * phases[target, t])).astype(np.complex64))
    return ParallelScene(frames, positions, cells)


def moved(states: NDArray, rng: np.random.Generator,
          intensity: float) -> NDArray[np.float64]:
    """Return the positions (N, T, 2) of targets of nearly constant velocity (Eq. 2-4)."""
    state = states.reshape(len(states), 2, 2).copy()
    step = np.array([[1.0, 1.0], [0.0, 1.0]])
    spread = np.sqrt(intensity) * np.linalg.cholesky([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    positions = np.empty((len(states), N_FRAMES, 2))
    for t in range(N_FRAMES):
        if t:
            state = state @ step.T + rng.standard_normal(state.shape) @ spread.T
        positions[:, t] = state[:, :, 0]
    return positions
