"""How points that are mapped move with the map.

A map is a change of scaled coordinates u followed by an outer map,

    u = (p - middle) / scale,  q = outer (1 + change) u,

with the eight parameters of the change in rows: a b c, d e f, g h, in units of the scale.
"""

import numba

from track_before_detect.kernels.compile_flags import EXACT


@numba.njit(**EXACT)
def mapped_motion(points, middle, scale, change, outer, motion):
    """Write to motion[n, :, p] the derivative of x and y of a mapped point by parameter p.

    points : float64 (N, 2), before the map
    change, outer : float64 (3, 3), the first with the identity added
    motion : float64 (N, 2, P), of the first P parameters
    """
    n_parameters = motion.shape[2]
    for n in range(points.shape[0]):
        ux, uy = (points[n, 0] - middle[0]) / scale, (points[n, 1] - middle[1]) / scale
        depth = change[2, 0] * ux + change[2, 1] * uy + change[2, 2]
        x = (change[0, 0] * ux + change[0, 1] * uy + change[0, 2]) / depth
        y = (change[1, 0] * ux + change[1, 1] * uy + change[1, 2]) / depth
        u = (ux / depth, uy / depth, 1 / depth)
        far = outer[2, 0] * x + outer[2, 1] * y + outer[2, 2]
        for axis in range(2):
            at = (outer[axis, 0] * x + outer[axis, 1] * y + outer[axis, 2]) / far
            by_x = (outer[axis, 0] - at * outer[2, 0]) / (far * scale)
            by_y = (outer[axis, 1] - at * outer[2, 1]) / (far * scale)
            for k in range(3):
                motion[n, axis, k] = by_x * u[k]
                motion[n, axis, 3 + k] = by_y * u[k]
            for p in range(6, n_parameters):
                motion[n, axis, p] = -(by_x * x + by_y * y) * u[p - 6]
