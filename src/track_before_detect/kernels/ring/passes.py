"""Mean of the merit functions of both directions (Fu et al. 2022, Eq. 9).

Layout of every array
---------------------
merit : float32 (T, H, W)
    Of the forward pass; becomes the mean.
backward : float32 (K, H, W)
    Of the backward pass; frame t is in plane t % K.
"""

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import FUSED, Offset

_U = Offset


@numba.njit(**FUSED)
def _mean(out, o, other, a, n):
    for x in range(_U(n)):
        out[o + x] = np.float32(0.5) * (out[o + x] + other[a + x])


@numba.njit(**FUSED)
def average(merit, backward, start, n_steps, step, first_row, last_row):
    """Average rows ``first_row`` to ``last_row`` of the frames start, start + step, ..."""
    _, n_y, n_x = merit.shape
    flat, flat_backward = merit.reshape(merit.size), backward.reshape(backward.size)
    n = (last_row - first_row) * n_x
    for k in range(n_steps):
        t = start + k * step
        _mean(flat, _U((t * n_y + first_row) * n_x), flat_backward,
              _U((t % backward.shape[0] * n_y + first_row) * n_x), n)
