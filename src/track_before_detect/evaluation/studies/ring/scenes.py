"""The targets of Fu et al. 2022, Figures 5 and 7, in pixels; x to the right, y down.

What the text leaves open is chosen here, once: where an arc begins, which way round it goes, and
which targets the cases of Figure 7 have.
"""

import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.simulation.motions import direction

Pair = tuple[float, float]

# Fu et al., Section 4: frames, and the speed limit of each case of Figure 5.
SIDE_PX = 128
N_FRAMES = 100
SINGLE_V_MAX = {1: 2, 2: 1, 3: 1}
MULTI_V_MAX = 1
# Figure 7: which targets each case has. The text names all three; the times of Table 2, which grow
# with the number of targets, say that cases 1 and 2 have two.
MULTI_TARGETS = {1: ('line 1', 'line 2'), 2: ('line 1', 'arc'), 3: ('line 1', 'line 2', 'arc')}


def ring_single(case: int, n_frames: int) -> NDArray[np.float64]:
    """Return the target of a case of Figure 5, shape (T, 2).

    Cases 1 and 2 are lines. Case 3 is an arc of 20 px *diameter* around (64, 64) at 1 px/frame;
    it begins here to the right of its centre and goes from x towards y.
    """
    if case == 1:
        return _line((5, 10), (1.2, 1.1), n_frames)
    if case == 2:
        return _line((30, 20), (0.6, 0.8), n_frames)
    return _arc((64, 64), 10.0, 1.0, 0.0, n_frames)


def ring_multi(case: int, n_frames: int = N_FRAMES, first: int = 0) -> NDArray[np.float64]:
    """Return the targets of a case of Figure 7, shape (N, T, 2), from a frame on.

    The arc has 20 px *radius*. It meets line 1 in (67, 66), as the text says, here in the same
    frame, 53.75, and goes from x towards y.
    """
    meeting = math.atan2(20.0, 3.0)
    paths = {
        'line 1': _line((24, 34), (0.8, 0.6), first + n_frames),
        'line 2': _line((66, 73), (-0.6, -0.7), first + n_frames),
        'arc': _arc((64, 46), 20.0, 1.0, meeting - 53.75 / 20, first + n_frames)}
    return np.array([paths[name][first:] for name in MULTI_TARGETS[case]])


def point_frames(rng: np.random.Generator, targets: NDArray, snr: float,
                 side: int = SIDE_PX) -> NDArray[np.float32]:
    """Return frames with targets of one pixel in unit noise (Fu et al., Eq. 1).

    Parameters
    ----------
    rng : Generator
    targets : array, shape (N, T, 2)
        Positions; each target raises the pixel it is in, on a common pixel each by itself.
    snr : float
        Amplitude over the noise standard deviation of one pixel.
    side : int
        Of the frames, in pixels.
    """
    frames = rng.standard_normal((targets.shape[1], side, side), np.float32)
    for path in np.rint(targets).astype(np.int64):
        frames[np.arange(len(path)), path[:, 1], path[:, 0]] += snr
    return frames


def _line(start: Pair, velocity: Pair, n_frames: int) -> NDArray[np.float64]:
    return np.array(start, float) + np.arange(n_frames)[:, None] * np.array(velocity)


def _arc(centre: Pair, radius: float, speed: float, start: float,
         n_frames: int) -> NDArray[np.float64]:
    angle = start + speed / radius * np.arange(n_frames)
    return np.array(centre, float) + radius * direction(angle)
