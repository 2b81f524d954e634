"""The columns that many given paths share: their stamps, what they see, which paths use them.

Layout of every array
---------------------
A *place* is a position (x, y) that some path passes; it has one stamp. A *column*, of the matrix A
of the objective, is a place in one frame, shared by all paths that are there in that frame.

keys : int64 (C, 2), x and y of each place in units of 2^-40 px
stamps : float64 (C, K_y, K_x), unit norm or zero; origins : int32 (C, 2), pixel (x, y) of their
    first entry, such that the whole stamp lies inside the frame
shares : float64 (C,), energy of each stamp before it was scaled, over that of the whole stamp
column_place, column_frame : int32 (N,), ordered by frame
columns : int32 (P, T), the column of each path in each frame
residual : float64 (D, T, H, W), D = 2 for the real and the imaginary part, otherwise 1
correlations : float64 (D, N), inner product of each column with its frame of the residual
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, REORDERED
from track_before_detect.kernels.psf.psf_stamps import LEAST_SHARE

PLACES_PER_PX = 2.0**40


@numba.njit(**EXACT)
def find_outside(paths, height, width):
    """Return p * T + k of the first position outside the frame (or NaN), -1 without one."""
    n_paths, n_frames, _ = paths.shape
    for p in range(n_paths):
        for k in range(n_frames):
            x = paths[p, k, 0]
            y = paths[p, k, 1]
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                return p * n_frames + k
    return -1


@numba.njit(**EXACT)
def number_places(paths, bits):
    """Give each distinct position a number, with a hash table of 2**bits slots.

    Returns
    -------
    places : int32 array, shape (P, T)
    keys : int64 array, shape (C, 2)
    fits : bool
        False when the table is too small; the rest is then of no use.
    """
    n_paths, n_frames, _ = paths.shape
    places = np.empty((n_paths, n_frames), np.int32)
    table = np.full(1 << bits, -1, np.int32)
    mask = (1 << bits) - 1
    most = 1 << (bits - 1)
    keys = np.empty((most, 2), np.int64)
    n_places = 0
    for p in range(n_paths):
        for k in range(n_frames):
            key_x = np.int64(np.rint(paths[p, k, 0] * PLACES_PER_PX))
            key_y = np.int64(np.rint(paths[p, k, 1] * PLACES_PER_PX))
            mixed = (key_x * 0x1E3779B97F4A7C15) ^ (key_y * 0x42B2AE3D27D4EB4F)
            mixed = (mixed ^ (mixed >> 32)) * 0x1E3779B97F4A7C15
            slot = (mixed >> 33) & mask
            while True:
                place = table[slot]
                if place < 0:
                    if n_places == most:
                        return places, keys, False
                    place = n_places
                    table[slot] = place
                    keys[place, 0] = key_x
                    keys[place, 1] = key_y
                    n_places += 1
                    break
                if keys[place, 0] == key_x and keys[place, 1] == key_y:
                    break
                slot = (slot + 1) & mask
            places[p, k] = place
    return places, keys[:n_places].copy(), True


@numba.njit(**EXACT)
def number_columns(places, n_places):
    """Give each distinct (place, frame) a number; return columns, column_place, column_frame."""
    n_paths, n_frames = places.shape
    columns = np.empty((n_paths, n_frames), np.int32)
    column_place = np.empty(n_paths * n_frames, np.int32)
    column_frame = np.empty(n_paths * n_frames, np.int32)
    latest = np.full(n_places, -1, np.int32)
    n_columns = 0
    for k in range(n_frames):
        first = n_columns
        for p in range(n_paths):
            place = places[p, k]
            if latest[place] < first:
                latest[place] = n_columns
                column_place[n_columns] = place
                column_frame[n_columns] = k
                n_columns += 1
            columns[p, k] = latest[place]
    return columns, column_place[:n_columns].copy(), column_frame[:n_columns].copy()


@numba.njit(**EXACT)
def first_pixels(column_place, column_frame, origins, height, width):
    """Return the flat index of the first pixel of the stamp of each column, int64 (N,)."""
    starts = np.empty(column_place.size, np.int64)
    for c in range(column_place.size):
        place = column_place[c]
        # In 64 bits, for batches of more than 2^31 pixels.
        row = np.int64(column_frame[c]) * height + origins[place, 1]
        starts[c] = row * width + origins[place, 0]
    return starts


@numba.njit(**EXACT)
def render_gaussians(keys, sigma, integrated, half, height, width):
    """Return stamps, origins and shares of a Gaussian, cut at the border, then of unit norm.

    A pixel sees it at its centre or, ``integrated``, over its area.
    """
    n_places = keys.shape[0]
    size_y = min(2 * half + 1, height)
    size_x = min(2 * half + 1, width)
    stamps = np.empty((n_places, size_y, size_x))
    origins = np.empty((n_places, 2), np.int32)
    shares = np.empty(n_places)
    profile_x = np.empty(size_x)
    profile_y = np.empty(size_y)
    origin_y, share_y = 0, 0.0
    for c in range(n_places):
        origins[c, 0], share_x = _profile(
            keys[c, 0] / PLACES_PER_PX, sigma, integrated, half, width, profile_x)
        # Along a row, as in all frames of one row, it stays the same.
        if c == 0 or keys[c, 1] != keys[c - 1, 1]:
            origin_y, share_y = _profile(
                keys[c, 1] / PLACES_PER_PX, sigma, integrated, half, height, profile_y)
        origins[c, 1] = origin_y
        shares[c] = share_x * share_y
        factor = 1.0 if shares[c] > LEAST_SHARE else 0.0
        for i in range(size_y):
            for k in range(size_x):
                stamps[c, i, k] = factor * profile_y[i] * profile_x[k]
    return stamps, origins, shares


@numba.njit(**EXACT)
def _profile(position, sigma, integrated, half, extent, profile):
    """Fill one axis of a Gaussian stamp, of unit norm; return its first pixel and its share."""
    scale = -0.5 / (sigma * sigma)
    unit = 1 / (math.sqrt(2.0) * sigma)
    centre = int(math.ceil(position - 0.5))
    origin = min(max(centre - half, 0), extent - profile.size)
    profile[:] = 0.0
    inside = 0.0
    whole = 0.0
    for pixel in range(centre - half, centre + half + 1):
        if integrated:
            value = (math.erf(unit * (pixel + 0.5 - position))
                     - math.erf(unit * (pixel - 0.5 - position)))
        else:
            value = math.exp(scale * (pixel - position)**2)
        whole += value * value
        if 0 <= pixel < extent:
            profile[pixel - origin] = value
            inside += value * value
    profile /= math.sqrt(inside)
    return origin, inside / whole


@numba.njit(**EXACT)
def move_inside(stamps, origins, height, width):
    """Return stamps and origins as above from those of ``psf_stamps.render``, zero outside."""
    n_places, size, _ = stamps.shape
    size_y = min(size, height)
    size_x = min(size, width)
    moved = np.zeros((n_places, size_y, size_x))
    moved_origins = np.empty((n_places, 2), np.int32)
    for c in range(n_places):
        x = min(max(origins[c, 0], 0), width - size_x)
        y = min(max(origins[c, 1], 0), height - size_y)
        moved_origins[c, 0], moved_origins[c, 1] = x, y
        for i in range(max(y, origins[c, 1]), min(y + size_y, origins[c, 1] + size)):
            for k in range(max(x, origins[c, 0]), min(x + size_x, origins[c, 0] + size)):
                moved[c, i - y, k - x] = stamps[c, i - origins[c, 1], k - origins[c, 0]]
    return moved, moved_origins


@numba.njit(**EXACT)
def mask_stamps(stamps, origins, shares, column_place, column_frame, valid):
    """Return stamps and origins of each column: cut to the valid pixels, then of unit norm."""
    n_columns = column_place.size
    size_y, size_x = stamps.shape[1:]
    cut = np.zeros((n_columns, size_y, size_x))
    cut_origins = np.empty((n_columns, 2), np.int32)
    for c in range(n_columns):
        place = column_place[c]
        cut_origins[c] = origins[place]
        total = 0.0
        for i in range(size_y):
            for k in range(size_x):
                if valid[column_frame[c], origins[place, 1] + i, origins[place, 0] + k]:
                    cut[c, i, k] = stamps[place, i, k]
                    total += stamps[place, i, k]**2
        left = shares[place] * total > LEAST_SHARE
        factor = 1.0 / math.sqrt(total) if left else 0.0
        for i in range(size_y):
            for k in range(size_x):
                cut[c, i, k] *= factor
    return cut, cut_origins


@numba.njit(**REORDERED)
def _product(a, start_a, b, start_b, n):
    """Return the inner product of n entries of two flat arrays."""
    # Unsigned indices spare the test for negative ones.
    first_a = np.uint64(start_a)
    first_b = np.uint64(start_b)
    total = 0.0
    for k in range(np.uint64(n)):
        total += a[first_a + k] * b[first_b + k]
    return total


@numba.njit(**EXACT)
def correlate(chosen, stamps, starts, column_place, residual, correlations):
    """Fill the correlations of the chosen columns; ``starts`` is the first pixel of each, flat."""
    n_parts, _, _, width = residual.shape
    size_y, size_x = stamps.shape[1:]
    profiles = stamps.ravel()
    for d in range(n_parts):
        pixels = residual[d].ravel()
        for c in chosen:
            first = column_place[c] * size_y * size_x
            total = 0.0
            for i in range(size_y):
                total += _product(profiles, first + i * size_x, pixels, starts[c] + i * width,
                                  size_x)
            correlations[d, c] = total


@numba.njit(**REORDERED)
def path_statistics(chosen, columns, correlations, weights, non_negative, statistics):
    """Fill the statistic of the chosen paths and return the largest of all.

    ``weights``, shape (P, T), divide the correlations of each path; None where all are one.
    """
    largest = 0.0
    for p in chosen:
        total = 0.0
        for d in range(correlations.shape[0]):
            for k in range(columns.shape[1]):
                value = correlations[d, columns[p, k]]
                if weights is not None:
                    value /= weights[p, k]
                if non_negative:
                    value = max(value, 0.0)
                total += value * value
        statistics[p] = math.sqrt(total)
        largest = max(largest, statistics[p])
    return largest


@numba.njit(**EXACT)
def columns_of(chosen, columns, n_columns):
    """Return the columns that the chosen paths use, in order."""
    used = np.zeros(n_columns, np.bool_)
    for p in chosen:
        for k in range(columns.shape[1]):
            used[columns[p, k]] = True
    return np.flatnonzero(used)


@numba.njit(**EXACT)
def subtract(members, amplitudes, columns, stamps, origins, column_place, residual):
    """Take amplitudes times stamps of some paths off the residual."""
    size_y, size_x = stamps.shape[1:]
    for row in range(members.size):
        for d in range(residual.shape[0]):
            for k in range(columns.shape[1]):
                amplitude = amplitudes[row, d, k]
                if amplitude == 0.0:
                    continue
                place = column_place[columns[members[row], k]]
                x = origins[place, 0]
                y = origins[place, 1]
                for i in range(size_y):
                    for j in range(size_x):
                        residual[d, k, y + i, x + j] -= amplitude * stamps[place, i, j]


@numba.njit(**EXACT)
def _overlap(place, other, profiles, size_y, size_x, origins):
    """Return the inner product of two stamps, given flat."""
    shift_x = origins[other, 0] - origins[place, 0]
    shift_y = origins[other, 1] - origins[place, 1]
    if abs(shift_x) >= size_x or abs(shift_y) >= size_y:
        return 0.0
    first = place * size_y * size_x + max(0, shift_x)
    other_first = other * size_y * size_x + max(0, -shift_x)
    total = 0.0
    for i in range(max(0, shift_y), min(size_y, size_y + shift_y)):
        total += _product(profiles, first + i * size_x, profiles,
                          other_first + (i - shift_y) * size_x, size_x - abs(shift_x))
    return total


@numba.njit(**EXACT)
def fill_gram(places, n_old, stamps, origins, gram):
    """Fill the rows and columns of ``gram`` that belong to members ``n_old`` and later.

    ``places``, shape (n, T), are those of the members.
    """
    _, size_y, size_x = stamps.shape
    profiles = stamps.ravel()
    for a in range(n_old, places.shape[0]):
        for b in range(a + 1):
            for k in range(places.shape[1]):
                value = _overlap(places[a, k], places[b, k], profiles, size_y, size_x, origins)
                gram[a, b, k] = value
                gram[b, a, k] = value


@numba.njit(**EXACT)
def pick_distinct(places, most, alike, stamps, origins):
    """Return the rows of at most ``most`` of the paths that are not ``alike`` to one before.

    ``places``, shape (n, T), are in the order of preference; likeness is the mean overlap in up
    to five frames.
    """
    _, size_y, size_x = stamps.shape
    profiles = stamps.ravel()
    n_frames = places.shape[1]
    n_looks = min(n_frames, 5)
    taken = np.empty(most, np.int64)
    n_taken = 0
    for p in range(places.shape[0]):
        new = True
        for row in range(n_taken):
            total = 0.0
            for look in range(n_looks):
                k = look * (n_frames - 1) // max(n_looks - 1, 1)
                total += _overlap(places[p, k], places[taken[row], k], profiles, size_y, size_x,
                                  origins)
            if total > alike * n_looks:
                new = False
                break
        if new:
            taken[n_taken] = p
            n_taken += 1
            if n_taken == most:
                break
    return taken[:n_taken].copy()
