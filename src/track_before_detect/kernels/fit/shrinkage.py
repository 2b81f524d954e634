"""Group shrinkage in information form: the amplitudes of one path, all others fixed.

Where the columns of a path have one norm in all frames it has the closed form of Algorithm 2 (see
the sweeps of ``group_lasso``); where they have not, or frames have weights of their own, the norm
of the solution is found on a line (Algorithm 1).
"""

import math

import numba

from track_before_detect.kernels.compile_flags import EXACT

# Newton steps on a concave function of one variable; a handful settle all digits.
MOST_LINE_STEPS = 60


@numba.njit(**EXACT)
def shrunk_norm(row, diagonal, weight):
    """Return the norm s of the minimiser of 1/2 x'Dx - h'x + weight |x| (Patent Eq. 10-11).

    The minimiser is x_k = h_k / (d_k + weight / s), the s that fits its own norm found on a line
    (Algorithm 1): s -> |x(s) / s|^-1 is concave, and a line where all entries of D are equal, so
    that Newton steps from s = 0 climb to its crossing of one and never pass it.

    Parameters
    ----------
    row : array, shape (D, T)
        h, already non-negative where the amplitudes have to be.
    diagonal : array, shape (T,)
        Entries of the diagonal matrix, above zero wherever ``row`` is not zero.
    weight : float
        Above zero.
    """
    size = 0.0
    for _ in range(MOST_LINE_STEPS):
        total = 0.0
        slope = 0.0
        for d in range(row.shape[0]):
            for k in range(row.shape[1]):
                below = size * diagonal[k] + weight
                part = (row[d, k] / below)**2
                total += part
                slope += part * diagonal[k] / below
        if total <= 1.0 or slope == 0.0:
            break
        step = (math.sqrt(total) - 1.0) * total / slope
        size += step
        if step <= 1e-15 * size:
            break
    return size
