"""A group lasso over many given paths that share positions.

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

and for the n paths of a working set

matched : float64 (n, D, T), inner products with the data
gram : float64 (n, n, T), inner products of the stamps of two paths in one frame
amplitudes, slack : float64 (n, D, T), x and matched - gram x
"""

import math

import numba
import numpy as np

_COMPILE = {'nogil': True, 'cache': True}
# Sums may be reordered, which lets them run on several lanes at once.
_FAST = {'nogil': True, 'cache': True, 'fastmath': {'reassoc', 'contract'}}

PLACES_PER_PX = 2.0**40
# Share of the energy of a stamp below which it counts as none, as in the kernels of the stamps.
LEAST_ENERGY = 1e-6


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
def _normalise(stamp):
    total = 0.0
    for value in stamp.flat:
        total += value * value
    factor = 1.0 / math.sqrt(total) if total > LEAST_ENERGY else 0.0
    for i in range(stamp.shape[0]):
        for k in range(stamp.shape[1]):
            stamp[i, k] *= factor


@numba.njit(**_COMPILE)
def render_gaussians(keys, sigma, half, height, width):
    """Return stamps and origins of a Gaussian of peak one, cut at the border, then unit norm."""
    n_places = keys.shape[0]
    size_y = min(2 * half + 1, height)
    size_x = min(2 * half + 1, width)
    stamps = np.empty((n_places, size_y, size_x))
    origins = np.empty((n_places, 2), np.int32)
    profile_x = np.empty(size_x)
    profile_y = np.empty(size_y)
    scale = -0.5 / (sigma * sigma)
    for c in range(n_places):
        origins[c, 0] = _profile(keys[c, 0] / PLACES_PER_PX, scale, half, width, profile_x)
        origins[c, 1] = _profile(keys[c, 1] / PLACES_PER_PX, scale, half, height, profile_y)
        for i in range(size_y):
            for k in range(size_x):
                stamps[c, i, k] = profile_y[i] * profile_x[k]
        _normalise(stamps[c])
    return stamps, origins


@numba.njit(**_COMPILE)
def _profile(position, scale, half, extent, profile):
    """Fill one axis of a Gaussian stamp and return its first pixel."""
    centre = int(math.floor(position + 0.5))
    origin = min(max(centre - half, 0), extent - profile.size)
    for k in range(profile.size):
        pixel = origin + k
        profile[k] = 0.0
        if abs(pixel - centre) <= half:
            profile[k] = math.exp(scale * (pixel - position)**2)
    return origin


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
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


@numba.njit(**_FAST)
def _product(a, start_a, b, start_b, n):
    """Return the inner product of n entries of two flat arrays."""
    # Unsigned indices spare the test for negative ones.
    first_a = np.uint64(start_a)
    first_b = np.uint64(start_b)
    total = 0.0
    for k in range(np.uint64(n)):
        total += a[first_a + k] * b[first_b + k]
    return total


@numba.njit(**_COMPILE)
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


@numba.njit(**_FAST)
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


@numba.njit(**_COMPILE)
def cells_of(chosen, cells, n_cells):
    """Return the cells that the chosen paths use, in order."""
    used = np.zeros(n_cells, np.bool_)
    for p in chosen:
        for k in range(cells.shape[1]):
            used[cells[p, k]] = True
    return np.flatnonzero(used)


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
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


@numba.njit(**_COMPILE)
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


@numba.njit(**_FAST)
def _norm(row):
    total = 0.0
    for value in row.flat:
        total += value * value
    return math.sqrt(total)


@numba.njit(**_FAST)
def _change(slack, gram, path, step):
    """Bring the slack of all members up to date with a change of one of them."""
    n_paths, n_parts, n_frames = slack.shape
    for p in range(n_paths):
        for d in range(n_parts):
            for k in range(n_frames):
                slack[p, d, k] -= gram[path, p, k] * step[d, k]


@numba.njit(**_COMPILE)
def _sweep(amplitudes, slack, gram, weight, non_negative, step):
    """Minimise path by path, once over all members (Algorithm 3)."""
    n_paths, n_parts, n_frames = amplitudes.shape
    for p in range(n_paths):
        total = 0.0
        for d in range(n_parts):
            for k in range(n_frames):
                # A masked stamp has no norm; its slack is zero and its amplitude stays so.
                value = slack[p, d, k] + gram[p, p, k] * amplitudes[p, d, k]
                if non_negative and value < 0.0:
                    value = 0.0
                step[d, k] = value
                total += value * value
        norm = math.sqrt(total)
        factor = 1.0 - weight / norm if norm > weight else 0.0
        moved = False
        for d in range(n_parts):
            for k in range(n_frames):
                value = factor * step[d, k]
                step[d, k] = value - amplitudes[p, d, k]
                moved = moved or step[d, k] != 0.0
                amplitudes[p, d, k] = value
        if moved:
            _change(slack, gram, p, step)


@numba.njit(**_COMPILE)
def dual_scale(product, residual, largest, weight):
    """Return the scale of the residual that makes it the best feasible point of the dual."""
    scale = product / residual if residual > 0.0 else 0.0
    if scale * largest > weight:
        scale = weight / largest
    return scale


@numba.njit(**_COMPILE)
def dual_value(product, residual, largest, weight):
    """Return the largest dual value of a multiple of the residual that is feasible.

    ``product`` is the inner product of data and residual, ``residual`` its squared norm.
    """
    scale = dual_scale(product, residual, largest, weight)
    return scale * product - 0.5 * scale * scale * residual


@numba.njit(**_COMPILE)
def value_and_gap(amplitudes, matched, slack, weight, non_negative, energy):
    """Return objective and duality gap over the members, and their largest statistic."""
    n_paths = amplitudes.shape[0]
    shrinkage = 0.0
    cross = 0.0
    explained = 0.0
    largest = 0.0
    for p in range(n_paths):
        shrinkage += weight * _norm(amplitudes[p])
        total = 0.0
        for d in range(amplitudes.shape[1]):
            for k in range(amplitudes.shape[2]):
                cross += matched[p, d, k] * amplitudes[p, d, k]
                explained += slack[p, d, k] * amplitudes[p, d, k]
                value = slack[p, d, k]
                if non_negative and value < 0.0:
                    value = 0.0
                total += value * value
        largest = max(largest, math.sqrt(total))
    # With r the residual: r'r = y'y - x'h - x'c and y'r = y'y - x'h, c the slack.
    residual = 2.0 * energy - cross - explained
    product = 2.0 * energy - cross
    objective = 0.5 * residual + shrinkage
    return objective, max(objective - dual_value(product, residual, largest, weight), 0.0), largest


@numba.njit(**_FAST)
def _dot(a, b, n):
    total = 0.0
    for i in range(n):
        total += a[i] * b[i]
    return total


@numba.njit(**_COMPILE)
def _factor(matrix):
    """Replace the lower triangle of a matrix by its Cholesky factor; False when there is none."""
    n = matrix.shape[0]
    for i in range(n):
        for j in range(i):
            matrix[i, j] = (matrix[i, j] - _dot(matrix[i], matrix[j], j)) / matrix[j, j]
        rest = matrix[i, i] - _dot(matrix[i], matrix[i], i)
        if rest <= 0.0:
            return False
        matrix[i, i] = math.sqrt(rest)
    return True


@numba.njit(**_COMPILE)
def _forward(factor, vector):
    for i in range(vector.size):
        vector[i] = (vector[i] - _dot(factor[i], vector, i)) / factor[i, i]


@numba.njit(**_COMPILE)
def _backward(factor, vector):
    for i in range(vector.size - 1, -1, -1):
        vector[i] /= factor[i, i]
        for j in range(i):
            vector[j] -= factor[i, j] * vector[i]


@numba.njit(**_COMPILE)
def _newton_step(active, amplitudes, slack, gram, weight, non_negative, ridge, step):
    """Fill the Newton step of the active paths; False when the Hessian has no factor.

    The Hessian is block-diagonal in the frames (the Gram matrix of each and the curvature
    weight / norm of the group norm) less one vector per path, which joins its frames: a system
    per frame and one between the paths (Woodbury) instead of one of all amplitudes.
    """
    n_active = active.size
    _, n_parts, n_frames = amplitudes.shape
    norms = np.empty(n_active)
    for a in range(n_active):
        norms[a] = _norm(amplitudes[active[a]])
    n_blocks = n_parts * n_frames
    factors = np.zeros((n_blocks, n_active, n_active))
    joined = np.zeros((n_blocks, n_active, n_active))
    between = np.zeros((n_active, n_active))
    right = np.zeros(n_active)
    column = np.empty(n_active)
    for block in range(n_blocks):
        d = block // n_frames
        k = block % n_frames
        factor = factors[block]
        for a in range(n_active):
            p = active[a]
            x = amplitudes[p, d, k]
            free = x > 0.0 or not non_negative
            for b in range(a):
                other = amplitudes[active[b], d, k]
                if free and (other > 0.0 or not non_negative):
                    factor[a, b] = gram[p, active[b], k]
            factor[a, a] = (gram[p, p, k] if free else 1.0) + weight / norms[a] + ridge
            step[a, d, k] = slack[p, d, k] - weight * x / norms[a] if free else 0.0
        if not _factor(factor):
            return False
        _forward(factor, step[:, d, k])
        # Rows of joined: transposed L^-1 diag(u), with u = x sqrt(weight / norm^3).
        for a in range(n_active):
            u = amplitudes[active[a], d, k] * math.sqrt(weight / norms[a]**3)
            if u == 0.0:
                continue
            column[:] = 0.0
            column[a] = u
            for i in range(a, n_active):
                column[i] = (column[i] - _dot(factor[i, a:], column[a:], i - a)) / factor[i, i]
            joined[block, a, :] = column
            right[a] += _dot(column, step[:, d, k], n_active)
        for a in range(n_active):
            for b in range(a + 1):
                between[a, b] -= _dot(joined[block, a, a:], joined[block, b, a:], n_active - a)
    for a in range(n_active):
        between[a, a] += 1.0 + ridge
    if not _factor(between):
        return False
    _forward(between, right)
    _backward(between, right)
    for block in range(n_blocks):
        d = block // n_frames
        k = block % n_frames
        for a in range(n_active):
            if right[a] != 0.0:
                for i in range(a, n_active):
                    step[i, d, k] += joined[block, a, i] * right[a]
        _backward(factors[block], step[:, d, k])
    return True


@numba.njit(**_COMPILE)
def _slack(amplitudes, matched, gram, slack):
    slack[:] = matched
    for p in range(amplitudes.shape[0]):
        if amplitudes[p].any():
            _change(slack, gram, p, amplitudes[p])


@numba.njit(**_COMPILE)
def solve(amplitudes, matched, gram, slack, weight, non_negative, energy, gap_wanted, most_rounds):
    """Minimise over the members to a duality gap, in place; return (gap, rounds made).

    Sweeps of coordinate descent find which paths are active, Newton steps where they settle: the
    sweeps alone would take thousands of rounds on paths that are nearly alike.
    """
    n_paths, n_parts, n_frames = amplitudes.shape
    row = np.empty((n_parts, n_frames))
    _slack(amplitudes, matched, gram, slack)
    trial = np.empty_like(amplitudes)
    trial_slack = np.empty_like(slack)
    gap = math.inf
    ridge = 1e-9
    for rounds in range(most_rounds):
        for _ in range(2):
            _sweep(amplitudes, slack, gram, weight, non_negative, row)
        objective, gap, largest = value_and_gap(amplitudes, matched, slack, weight, non_negative,
                                                energy)
        if gap <= gap_wanted:
            return gap, rounds + 1
        count = 0
        active = np.empty(n_paths, np.int64)
        for p in range(n_paths):
            if amplitudes[p].any():
                active[count] = p
                count += 1
        active = active[:count]
        if count == 0:
            continue
        step = np.empty((count, n_parts, n_frames))
        if not _newton_step(active, amplitudes, slack, gram, weight, non_negative, ridge, step):
            ridge *= 100.0
            continue
        length = 1.0
        for _ in range(6):
            trial[:] = amplitudes
            for a in range(count):
                p = active[a]
                product = 0.0
                for d in range(n_parts):
                    for k in range(n_frames):
                        value = amplitudes[p, d, k] + length * step[a, d, k]
                        if non_negative and value < 0.0:
                            value = 0.0
                        trial[p, d, k] = value
                        product += value * amplitudes[p, d, k]
                if product <= 0.0:
                    # A step through zero ends there.
                    trial[p] = 0.0
            _slack(trial, matched, gram, trial_slack)
            reached, new_gap, _ = value_and_gap(trial, matched, trial_slack, weight,
                                                non_negative, energy)
            if reached < objective or (new_gap < gap and reached <= objective + 1e-14 * energy):
                amplitudes[:] = trial
                slack[:] = trial_slack
                gap = new_gap
                break
            length *= 0.4
        if gap <= gap_wanted:
            return gap, rounds + 1
    return gap, most_rounds + 1
