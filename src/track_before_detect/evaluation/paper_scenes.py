"""The targets of the papers on dynamic programming, in pixels; x to the right, y down.

Fu et al. 2022 (Figures 5 and 7) and Guo et al. 2018 (Section 4.2). What their texts leave open is
chosen here, once: where an arc begins and which way round it goes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

# Fu et al., Section 4: frames, and the speed limit of each case of Figure 5.
RING_SIDE_PX = 128
RING_FRAMES = 100
SINGLE_V_MAX = {1: 2, 2: 1, 3: 1}
MULTI_V_MAX = 1
# Figure 7: which targets each case has. The text names all three; the times of Table 2, which grow
# with the number of targets, say that cases 1 and 2 have two.
MULTI_TARGETS = {1: ('line 1', 'line 2'), 2: ('line 1', 'arc'), 3: ('line 1', 'line 2', 'arc')}
# Guo et al., Section 4.2: side of the region in cells, and scans of a batch.
PARALLEL_SIDE = 50
PARALLEL_SCANS = 6
_PARALLEL_STATES = ((13.1, 1.0, 30.8, 0.9), (20.1, -1.0, 30.8, 1.0), (10.1, 1.0, 10.8, 0.9),
                    (30.1, 1.0, 10.8, 0.0), (30.1, 1.0, 8.2, 0.0), (35.1, -0.9, 35.8, 1.0))


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


def ring_multi(case: int, n_frames: int = RING_FRAMES, first: int = 0) -> NDArray[np.float64]:
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


def parallel_six() -> NDArray[np.float64]:
    """Return the six targets of Guo et al., Section 4.2, shape (6, 6, 2).

    Targets 1 and 2 cross, 4 and 5 are side by side, 3 and 6 are alone.
    """
    return np.array([_line((x, y), (vx, vy), PARALLEL_SCANS)
                     for x, vx, y, vy in _PARALLEL_STATES])


def point_frames(rng: np.random.Generator, targets: NDArray, snr: float,
                 side: int) -> NDArray[np.float32]:
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


def _line(start, velocity, n_frames):
    return np.array(start, float) + np.arange(n_frames)[:, None] * np.array(velocity)


def _arc(centre, radius, speed, start, n_frames):
    angle = start + speed / radius * np.arange(n_frames)
    return np.array(centre, float) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
