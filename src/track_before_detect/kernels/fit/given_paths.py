"""Positions that many given paths share: their stamps, what they see, which paths pass them.

Layout of every array
---------------------
A *place* is a position (x, y) that some path passes; it has one stamp. A *cell* is a place in one
frame: the unit of pricing, shared by all paths that are there in that frame.

keys : int64 (C, 2), x and y of each place in units of 2^-40 px
stamps : float64 (C, K_y, K_x), unit norm or zero; origins : int32 (C, 2), pixel (x, y) of their
    first entry, such that the whole stamp lies inside the frame
cell_place, cell_frame : int32 (N,), ordered by frame
cells : int32 (P, T), the cell of each path in each frame
residual : float64 (D, T, H, W), D = 2 for the real and the imaginary part, otherwise 1
seen : float64 (D, N), inner product of the stamp of each cell with its frame
"""

import math

import numba
import numpy as np

from track_before_detect.kernels.compile_flags import EXACT, REORDERED

PLACES_PER_PX = 2.0**40
# Share of the energy of a stamp below which it counts as none, as in the kernels of the stamps.
LEAST_ENERGY = 1e-6


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
def number_cells(places, n_places):
    """Give each distinct (place, frame) a number; return cells, cell_place, cell_frame."""
    n_paths, n_frames = places.shape
    cells = np.empty((n_paths, n_frames), np.int32)
    cell_place = np.empty(n_paths * n_frames, np.int32)
    cell_frame = np.empty(n_paths * n_frames, np.int32)
    latest = np.full(n_places, -1, np.int32)
    n_cells = 0
    for k in range(n_frames):
        first = n_cells
        for p in range(n_paths):
            place = places[p, k]
            if latest[place] < first:
                latest[place] = n_cells
                cell_place[n_cells] = place
                cell_frame[n_cells] = k
                n_cells += 1
            cells[p, k] = latest[place]
    return cells, cell_place[:n_cells].copy(), cell_frame[:n_cells].copy()


@numba.njit(**EXACT)
def first_pixels(cell_place, cell_frame, origins, height, width):
    """Return the flat index of the first pixel of the stamp of each cell, int64 (N,)."""
    starts = np.empty(cell_place.size, np.int64)
    for c in range(cell_place.size):
        place = cell_place[c]
        # In 64 bits, for batches of more than 2^31 pixels.
        row = np.int64(cell_frame[c]) * height + origins[place, 1]
        starts[c] = row * width + origins[place, 0]
    return starts


@numba.njit(**EXACT)
def _normalise(stamp):
    total = 0.0
    for value in stamp.flat:
        total += value * value
    factor = 1.0 / math.sqrt(total) if total > LEAST_ENERGY else 0.0
    for i in range(stamp.shape[0]):
        for k in range(stamp.shape[1]):
            stamp[i, k] *= factor


@numba.njit(**EXACT)
def render_gaussians(keys, sigma, integrated, half, height, width):
    """Return stamps and origins of a Gaussian, cut at the border, then of unit norm.

    A pixel sees it at its centre or, ``integrated``, over its area.
    """
    n_places = keys.shape[0]
    size_y = min(2 * half + 1, height)
    size_x = min(2 * half + 1, width)
    stamps = np.empty((n_places, size_y, size_x))
    origins = np.empty((n_places, 2), np.int32)
    profile_x = np.empty(size_x)
    profile_y = np.empty(size_y)
    for c in range(n_places):
        origins[c, 0] = _profile(
            keys[c, 0] / PLACES_PER_PX, sigma, integrated, half, width, profile_x)
        origins[c, 1] = _profile(
            keys[c, 1] / PLACES_PER_PX, sigma, integrated, half, height, profile_y)
        for i in range(size_y):
            for k in range(size_x):
                stamps[c, i, k] = profile_y[i] * profile_x[k]
        _normalise(stamps[c])
    return stamps, origins


@numba.njit(**EXACT)
def _profile(position, sigma, integrated, half, extent, profile):
    """Fill one axis of a Gaussian stamp and return its first pixel."""
    scale = -0.5 / (sigma * sigma)
    unit = 1 / (math.sqrt(2.0) * sigma)
    centre = int(math.ceil(position - 0.5))
    origin = min(max(centre - half, 0), extent - profile.size)
    for k in range(profile.size):
        pixel = origin + k
        profile[k] = 0.0
        if abs(pixel - centre) <= half:
            if integrated:
                profile[k] = (math.erf(unit * (pixel + 0.5 - position))
                              - math.erf(unit * (pixel - 0.5 - position)))
            else:
                profile[k] = math.exp(scale * (pixel - position)**2)
    return origin


@numba.njit(**EXACT)
def render_array(keys, psf, height, width):
    """Return stamps and origins of an array of unit norm, moved by bilinear interpolation."""
    n_places = keys.shape[0]
    size_y = min(psf.shape[0] + 1, height)
    size_x = min(psf.shape[1] + 1, width)
    stamps = np.zeros((n_places, size_y, size_x))
    origins = np.empty((n_places, 2), np.int32)
    for c in range(n_places):
        x = keys[c, 0] / PLACES_PER_PX
        y = keys[c, 1] / PLACES_PER_PX
        first_x = int(math.floor(x)) - psf.shape[1] // 2
        first_y = int(math.floor(y)) - psf.shape[0] // 2
        origins[c, 0] = min(max(first_x, 0), width - size_x)
        origins[c, 1] = min(max(first_y, 0), height - size_y)
        for corner in range(4):
            move_x = corner % 2
            move_y = corner // 2
            share_x = x - math.floor(x)
            share_y = y - math.floor(y)
            share = (share_x if move_x else 1 - share_x) * (share_y if move_y else 1 - share_y)
            if share == 0.0:
                continue
            for i in range(psf.shape[0]):
                row = first_y + move_y + i - origins[c, 1]
                if not 0 <= row < size_y:
                    continue
                for k in range(psf.shape[1]):
                    column = first_x + move_x + k - origins[c, 0]
                    if 0 <= column < size_x:
                        stamps[c, row, column] += share * psf[i, k]
        _normalise(stamps[c])
    return stamps, origins


@numba.njit(**EXACT)
def mask_stamps(stamps, origins, cell_place, cell_frame, valid):
    """Return stamps and origins of each cell: cut to the valid pixels, then of unit norm."""
    n_cells = cell_place.size
    size_y, size_x = stamps.shape[1:]
    cut = np.zeros((n_cells, size_y, size_x))
    cut_origins = np.empty((n_cells, 2), np.int32)
    for c in range(n_cells):
        place = cell_place[c]
        cut_origins[c] = origins[place]
        for i in range(size_y):
            for k in range(size_x):
                if valid[cell_frame[c], origins[place, 1] + i, origins[place, 0] + k]:
                    cut[c, i, k] = stamps[place, i, k]
        _normalise(cut[c])
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
def correlate_cells(chosen, stamps, starts, cell_place, residual, seen):
    """Fill ``seen`` for the chosen cells; ``starts`` is the flat first pixel of each cell."""
    n_parts, _, _, width = residual.shape
    size_y, size_x = stamps.shape[1:]
    profiles = stamps.ravel()
    for d in range(n_parts):
        pixels = residual[d].ravel()
        for c in chosen:
            first = cell_place[c] * size_y * size_x
            total = 0.0
            for i in range(size_y):
                total += _product(profiles, first + i * size_x, pixels, starts[c] + i * width,
                                  size_x)
            seen[d, c] = total


@numba.njit(**REORDERED)
def price(chosen, cells, seen, non_negative, statistics):
    """Fill the statistic of the chosen paths and return the largest of all."""
    largest = 0.0
    n_frames = cells.shape[1]
    for p in chosen:
        total = 0.0
        for d in range(seen.shape[0]):
            if non_negative:
                for k in range(n_frames):
                    value = max(seen[d, cells[p, k]], 0.0)
                    total += value * value
            else:
                for k in range(n_frames):
                    value = seen[d, cells[p, k]]
                    total += value * value
        statistics[p] = math.sqrt(total)
        largest = max(largest, statistics[p])
    return largest


@numba.njit(**REORDERED)
def price_weighted(chosen, cells, seen, weights, non_negative, statistics):
    """Do what ``price`` does with ``seen`` over the weight (P, T) of each path in each frame."""
    largest = 0.0
    for p in chosen:
        total = 0.0
        for d in range(seen.shape[0]):
            for k in range(cells.shape[1]):
                value = seen[d, cells[p, k]] / weights[p, k]
                if value > 0.0 or not non_negative:
                    total += value * value
        statistics[p] = math.sqrt(total)
        largest = max(largest, statistics[p])
    return largest


@numba.njit(**EXACT)
def cells_of(chosen, cells, n_cells):
    """Return the cells that the chosen paths use, in order."""
    used = np.zeros(n_cells, np.bool_)
    for p in chosen:
        for k in range(cells.shape[1]):
            used[cells[p, k]] = True
    return np.flatnonzero(used)


@numba.njit(**EXACT)
def subtract(members, amplitudes, cells, stamps, origins, cell_place, residual):
    """Take amplitudes times stamps of some paths off the residual."""
    size_y, size_x = stamps.shape[1:]
    for row in range(members.size):
        for d in range(residual.shape[0]):
            for k in range(cells.shape[1]):
                amplitude = amplitudes[row, d, k]
                if amplitude == 0.0:
                    continue
                place = cell_place[cells[members[row], k]]
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
def relate(places, n_old, stamps, origins, gram):
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
def pick(places, most, alike, stamps, origins):
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
