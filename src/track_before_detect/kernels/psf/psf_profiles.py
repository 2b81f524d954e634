"""One-dimensional profiles of a PSF as cubic splines, the parts that every stamp is made of.

A stamp is a sum of products of a profile in y and one in x,

    stamp[i, k] = sum over components c and nodes m of
                  share[m] f_c(i - y - m_y) g_c(k - x - m_x),   m = node[m] * smear,

the nodes being the moments of the exposure that smears a moving target along its velocity; without
a smear there is one node at zero.
"""

from collections import namedtuple
import math

import numba

from track_before_detect.kernels.compile_flags import EXACT

Optics = namedtuple('Optics', ('coefficients', 'per_px', 'half', 'nodes', 'shares', 'curvature',
                               'exposure', 'longest_smear', 'times'))
"""What the compiled loops know of a PSF.

Attributes
----------
coefficients : float64 (C, 2, N)
    Of cubic B-splines, for each component its profile in y and then in x; N odd, the middle one
    belongs to the centre of the target.
per_px : int
    Coefficients per pixel.
half : int
    Half width of a stamp in pixels.
nodes, shares : float64 (M,)
    Moments of the exposure, -1/2 to 1/2, and their shares of it.
curvature : float64 (2,)
    Squared norm of the slope of the unit-norm stamp in x and in y.
exposure : float
    In the unit of ``times``.
longest_smear : float
    Pixels; a longer smear is cut to this, for which the stamps are large enough.
times : float64 (T,)
    Time of each frame; of no frames where the exposure is zero.
"""


@numba.njit(**EXACT)
def smear_of(optics, positions, t):
    """Return the way (x, y) that a target moves during the exposure of frame t."""
    if optics.exposure == 0.0:
        return 0.0, 0.0
    before = max(t - 1, 0)
    after = min(t + 1, positions.shape[0] - 1)
    if after == before:
        return 0.0, 0.0
    factor = optics.exposure / (optics.times[after] - optics.times[before])
    x = factor * (positions[after, 0] - positions[before, 0])
    y = factor * (positions[after, 1] - positions[before, 1])
    length = math.sqrt(x * x + y * y)
    if length > optics.longest_smear:
        x *= optics.longest_smear / length
        y *= optics.longest_smear / length
    return x, y


@numba.njit(**EXACT)
def fill_profiles(optics, position, smear, axis, origin, factors, values, slopes):
    """Write the profiles of all components and nodes along one axis, and their slopes.

    values, slopes : float64 (C * M, K), for the pixels from ``origin`` on; the slope is that by
    the position. ``factors`` (M,) multiplies the nodes.
    """
    n_components = optics.coefficients.shape[0]
    n_nodes = optics.nodes.size
    middle = optics.coefficients.shape[2] // 2
    last = optics.coefficients.shape[2] - 4
    per_px = optics.per_px
    for m in range(n_nodes):
        start = (origin - position - optics.nodes[m] * smear) * per_px + middle
        knot = int(math.floor(start))
        u = start - knot
        v = 1.0 - u
        factor = factors[m]
        b_0 = factor * v * v * v / 6.0
        b_1 = factor * (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
        b_2 = factor * (4.0 - 6.0 * v * v + 3.0 * v * v * v) / 6.0
        b_3 = factor * u * u * u / 6.0
        d_0 = 0.5 * factor * per_px * v * v
        d_1 = 0.5 * factor * per_px * (4.0 * u - 3.0 * u * u)
        d_2 = -0.5 * factor * per_px * (4.0 * v - 3.0 * v * v)
        d_3 = -0.5 * factor * per_px * u * u
        for c in range(n_components):
            row = optics.coefficients[c, axis]
            i = m * n_components + c
            for k in range(values.shape[1]):
                first = knot - 1 + k * per_px
                if 0 <= first <= last:
                    c_0, c_1, c_2, c_3 = row[first], row[first + 1], row[first + 2], row[first + 3]
                    values[i, k] = b_0 * c_0 + b_1 * c_1 + b_2 * c_2 + b_3 * c_3
                    slopes[i, k] = d_0 * c_0 + d_1 * c_1 + d_2 * c_2 + d_3 * c_3
                else:
                    values[i, k] = 0.0
                    slopes[i, k] = 0.0


@numba.njit(**EXACT)
def inner_product(rows, columns, other_rows, other_columns, first_row, last_row, first_column,
                  last_column):
    """Return the inner product of two sums of products, over a part of the stamp.

    They are sum_c rows[c, i] columns[c, k] and the same of ``other_rows`` and ``other_columns``.
    """
    total = 0.0
    for c in range(rows.shape[0]):
        for d in range(rows.shape[0]):
            in_y = 0.0
            for i in range(first_row, last_row):
                in_y += rows[c, i] * other_rows[d, i]
            in_x = 0.0
            for k in range(first_column, last_column):
                in_x += columns[c, k] * other_columns[d, k]
            total += in_y * in_x
    return total


@numba.njit(**EXACT)
def product_norm(rows, columns, first_row, last_row, first_column, last_column):
    """Return the squared norm of sum_c rows[c, i] columns[c, k] over a part of the stamp."""
    return inner_product(rows, columns, rows, columns, first_row, last_row, first_column,
                         last_column)
