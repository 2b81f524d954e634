"""Shift every column of a picture by its own number of rows."""

import numba

from track_before_detect.kernels.compile_flags import FUSED


@numba.njit(**FUSED)
def shear_rows(out, picture, shifts, outside, first_row, last_row):
    """Fill rows ``first_row`` to ``last_row`` of a sheared picture.

    out[y, x] = picture[y + shifts[x], x], and ``outside`` where there is no such row

    out : float32 (Y', X)
    picture : float32 (Y, X)
    shifts : int32 (X,)
    """
    n_y, n_x = picture.shape
    for y in range(first_row, last_row):
        for x in range(n_x):
            row = y + shifts[x]
            out[y, x] = picture[row, x] if 0 <= row < n_y else outside
